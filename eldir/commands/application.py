"""The command `eldir` with its sub-commands, which are found by their entry points."""

from __future__ import annotations

import logging
import os
import re
import sys
from importlib.metadata import entry_points
from typing import IO, Annotated, Any, cast

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from eldir.commands.main import fail
from eldir.core import program_log
from eldir.errors import EldirError

GROUP = "eldir.commands"
_logger = logging.getLogger(__name__)
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
    """Commands that Ctrl-C ends with a word; Typer alone ends them without. Each has the option -v."""

    def __init__(self, **values: Any):
        super().__init__(**values)
        shared = [option for option in self.params if option.name == "verbose"]
        waiting = list(self.commands.values())
        while waiting:
            command = waiting.pop()
            waiting += getattr(command, "commands", {}).values()
            if not any("-v" in option.opts for option in command.params):  # another package's own -v
                command.params += shared

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise _StoppedError from None


def application(asked: str = "") -> typer.Typer:
    """The command with every sub-command that is installed (entry-point group `eldir.commands`), or with the
    one that is `asked` for, if it is: building all others takes as long as loading them."""
    # Plain help: with markup, Typer loads rich's Markdown for half of the time of `eldir --help`.
    app = typer.Typer(
        cls=_Commands,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"max_content_width": 110},
    )

    @app.callback()
    def eldir(
        version: Annotated[
            bool,
            typer.Option(
                "--version", callback=_print_version, is_eager=True, help="Print the version; see eldir info."
            ),
        ] = False,
        verbose: Annotated[
            int,
            typer.Option(
                "--verbose",
                "-v",
                count=True,
                callback=_log_more,
                expose_value=False,
                show_default=False,
                help="Write on stderr what the program does; -vv also every frame from and to the devices.",
            ),
        ] = 0,
    ) -> None:
        """From an evolved robot in simulation to the same robot walking on a table.

        Example: eldir demo --out demo
        """

    found = {point.name: point for point in entry_points(group=GROUP)}
    loaded = {}
    for name in sorted(found, key=lambda n: (_ORDER.index(n) if n in _ORDER else len(_ORDER), n)):
        try:
            loaded[name] = found[name].load()
        except (Exception, SystemExit) as error:  # of another package: `eldir rig off` must work beside it
            _logger.warning(
                f"the command {name} cannot be loaded from {found[name].value}; "
                f"found {type(error).__name__}: {error}"
            )
    for name, command in loaded.items():
        if asked in loaded and name != asked:
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
    program_log.read_levels()  # wrong ones are an error
    _configure_log()
    try:
        asked = next((word for word in sys.argv[1:] if not word.startswith("-")), "")
        status = application(asked)(standalone_mode=False, prog_name="eldir")
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


def _log_more(steps: int) -> None:
    """-v, before or behind the words of the command."""
    if steps:
        program_log.raise_level(steps)
        _configure_log()


def _configure_log() -> None:
    """Lines as everywhere, or Rich's on a terminal where somebody asked for details."""
    if program_log.is_detailed() and os.isatty(2):
        from rich.console import Console
        from rich.logging import RichHandler

        screen = Console(file=cast("IO[str]", program_log.UnblockedStderr()))
        shown = RichHandler(
            console=screen, omit_repeated_times=False, show_path=False, log_time_format="%H:%M:%S.%f"
        )
        shown.setFormatter(logging.Formatter("%(name)s: %(message)s"))
        program_log.configure("eldir", shown)
    else:
        program_log.configure("eldir")


def _print_version(wanted: bool) -> None:
    if wanted:
        from eldir.commands.info import version_lines

        print(version_lines())
        raise typer.Exit
