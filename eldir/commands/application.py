"""The command `eldir` with its sub-commands, which are found by their entry points."""

from __future__ import annotations

import sys
from importlib.metadata import entry_points
from typing import Annotated

import typer
from typer.exceptions import TyperException

from eldir.commands.main import fail
from eldir.core.version import __version__

GROUP = "eldir.commands"
# As a user meets them on the way from a population to a report; others follow by name.
_ORDER = [
    "demo",
    "evolve",
    "status",
    "analyse",
    "shortlist",
    "show",
    "packet",
    "gait",
    "export",
    "transfer",
    "rig",
    "calibrate",
    "track",
    "report",
]


def application() -> typer.Typer:
    """The command with every sub-command that is installed (entry-point group `eldir.commands`)."""
    app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)

    @app.callback()
    def eldir(
        version: Annotated[
            bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
        ] = False,
    ) -> None:
        """From an evolved robot in simulation to the same robot walking on a table.

        Example: eldir demo --out demo
        """

    found = {point.name: point for point in entry_points(group=GROUP)}
    for name in sorted(found, key=lambda n: (_ORDER.index(n) if n in _ORDER else len(_ORDER), n)):
        try:
            command = found[name].load()
        except (Exception, SystemExit) as error:  # of another package: `eldir rig off` must work beside it
            print(
                f"eldir: the command {name} cannot be loaded from {found[name].value}; "
                f"found {type(error).__name__}: {error}",
                file=sys.stderr,
            )
            continue
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name)(command)
    return app


def run_application() -> int:
    """Run the command; returns its status. Raises `EldirError`, and `KeyboardInterrupt` for Ctrl-C."""
    try:
        status = application()(standalone_mode=False)
    except TyperException as error:  # wrong arguments
        message = error.format_message().rstrip(".")
        if not message:  # no arguments: the help has been printed
            return 2
        fail(message + "; see eldir --help", 2)
    except typer.Abort:
        raise KeyboardInterrupt from None
    return status if isinstance(status, int) else 0


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"eldir {__version__}")
        raise typer.Exit
