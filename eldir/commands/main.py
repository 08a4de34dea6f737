"""The command `eldir`: finds its sub-commands, and turns every failure into one line and a status."""

from __future__ import annotations

import sys
from importlib.metadata import entry_points
from typing import Annotated, NoReturn

import typer
from typer.exceptions import TyperException

from eldir.core.version import __version__
from eldir.errors import EldirError

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


def main() -> NoReturn:
    """Run the command; status 0 only when it did what it says, 2 for wrong arguments, 130 for Ctrl-C."""
    try:
        status = application()(standalone_mode=False)
    except TyperException as error:  # wrong arguments
        _fail(error.format_message().rstrip(".") + "; see eldir --help", 2)
    except (KeyboardInterrupt, typer.Abort):
        _fail("stopped", 130)
    except EldirError as error:
        _fail(str(error), 1)
    except BrokenPipeError:  # such as `eldir ... | head`
        sys.stderr.close()
        sys.exit(1)
    sys.exit(status if isinstance(status, int) else 0)


def _fail(message: str, status: int) -> NoReturn:
    print("eldir: " + " ".join(message.split()), file=sys.stderr)
    sys.exit(status)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"eldir {__version__}")
        raise typer.Exit
