"""The sub-commands of `eldir`: one module each, or a package of modules for a group; found by name.

They read options, call a function of a package below and print; decisions are made there.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import typer

ORDER = (
    "demo", "evolve", "status", "analyse", "shortlist", "show", "packet", "gait", "export", "transfer", "rig",
    "calibrate", "track", "report",
)  # fmt: skip
"""In the order of the work, from a population to a report; others follow by name."""


def create_group(package: str, order: Sequence[str], purpose: str) -> typer.Typer:
    """A group, such as `eldir rig`, of all sub-commands in a package; `purpose` is its help."""
    group = typer.Typer(no_args_is_help=True, help=purpose)
    for name in command_names(package, order):
        add_command(group, name, load_command(package, name))
    return group


def command_names(package: str, order: Sequence[str]) -> list[str]:
    """Names of the sub-commands in a package: first those in `order`, then the others by name. No module is
    imported."""
    names = [module.name for module in pkgutil.iter_modules(import_module(package).__path__)]
    return sorted(names, key=lambda n: (order.index(n) if n in order else len(order), n))


def load_command(package: str, name: str) -> Any:
    """A sub-command of a package: a function, or a group."""
    return getattr(import_module(f"{package}.{name}"), name)


def add_command(parent: typer.Typer, name: str, command: Any) -> None:
    """Add a sub-command, which is a function or a group, to a group."""
    if isinstance(command, typer.Typer):
        parent.add_typer(command, name=name)
    else:
        parent.command(name)(command)
