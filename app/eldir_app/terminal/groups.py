"""Sub-commands found in a room: a module, or a room in it, gives the function or the group of its name."""

from __future__ import annotations

import pkgutil
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import typer


def group(package: str, order: Sequence[str], purpose: str) -> typer.Typer:
    """The group of the sub-commands in a package, as `eldir rig` is one; `purpose` is its help."""
    found = typer.Typer(no_args_is_help=True, help=purpose)
    for name in names_in(package, order):
        add(found, name, load(package, name))
    return found


def names_in(package: str, order: Sequence[str]) -> list[str]:
    """Names of the sub-commands in a package, those in `order` first, others by name; none is loaded."""
    names = [module.name for module in pkgutil.iter_modules(import_module(package).__path__)]
    return sorted(names, key=lambda n: (order.index(n) if n in order else len(order), n))


def load(package: str, name: str) -> Any:
    """The sub-command of a package: a function, or a group."""
    return getattr(import_module(f"{package}.{name}"), name)


def add(parent: typer.Typer, name: str, command: Any) -> None:
    """Give a group one more sub-command, a function or a group."""
    if isinstance(command, typer.Typer):
        parent.add_typer(command, name=name)
    else:
        parent.command(name)(command)
