"""The command `eldir` with its sub-commands, which are found by their entry points."""

from __future__ import annotations

import logging
import re
import sys
from importlib.metadata import entry_points
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from eldir.commands.main import fail
from eldir.errors import EldirError

GROUP = "eldir.commands"
_INSTALL = "--install-completion"
_WORDS = (
    ("Input should be greater than or equal to ", "expected at least "),
    ("Input should be less than or equal to ", "expected at most "),
    ("Input should be a valid integer.*", "expected a whole number"),
    ("Input should be a valid number.*", "expected a number"),
    ("Value error, ", ""),
    ("Input should be ", "expected "),
)
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


class _StoppedError(Exception):
    """Ctrl-C."""


class _Commands(TyperGroup):
    """Commands that Ctrl-C ends with a word; Typer alone ends them without."""

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise _StoppedError from None


def application() -> typer.Typer:
    """The command with every sub-command that is installed (entry-point group `eldir.commands`)."""
    app = typer.Typer(cls=_Commands, no_args_is_help=True, pretty_exceptions_enable=False)

    @app.callback()
    def eldir(
        version: Annotated[
            bool,
            typer.Option(
                "--version", callback=_print_version, is_eager=True, help="Print the version; see eldir info."
            ),
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
    # Where a home cannot be written, Matplotlib says in three lines that it uses another folder.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    try:
        status = application()(standalone_mode=False, prog_name="eldir")
    except TyperException as error:  # wrong arguments
        message = error.format_message().rstrip(".")
        if not message:  # no arguments: the help has been printed
            return 2
        context = getattr(error, "ctx", None)
        command = "eldir" if context is None else context.command_path
        fail(f"{_in_plain_words(message)}; see {command} --help", 2)
    except (typer.Abort, _StoppedError):
        raise KeyboardInterrupt from None
    except OSError as error:
        if _INSTALL not in sys.argv:
            raise
        raise EldirError(
            f"cannot install completion: {error}", remedy="put the lines of --show-completion there yourself"
        ) from None
    return status if isinstance(status, int) else 0


def _in_plain_words(message: str) -> str:
    """A message about an argument, without the words of the library that checked it."""
    for theirs, ours in _WORDS:
        message = re.sub(theirs, ours, message)
    return message


def _print_version(wanted: bool) -> None:
    if wanted:
        from eldir.commands.info import version_lines

        print(version_lines())
        raise typer.Exit
