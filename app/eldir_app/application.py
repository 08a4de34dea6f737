"""The command `eldir` with its sub-commands: ours, and those of other packages."""

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

from eldir.core import program_log
from eldir.errors import EldirError, print_line
from eldir_app import commands
from eldir_app.terminal.groups import add, load, names_in

GROUP = "eldir.commands"
"""Entry points by which other packages add sub-commands."""
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
    """The command with our sub-commands, and those of other packages (entry-point group `eldir.commands`); or
    with the one of ours that is `asked` for, and nothing else is loaded."""
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

    ours = names_in(commands.__name__, commands.ORDER)
    for name in [asked] if asked in ours else ours:
        add(app, name, load(commands.__name__, name))
    for point in [] if asked in ours else sorted(entry_points(group=GROUP), key=lambda p: p.name):
        try:
            command = point.load()
        except (Exception, SystemExit) as error:  # of another package: `eldir rig off` must work beside it
            _logger.warning(
                f"the command {point.name} cannot be loaded from {point.value}; "
                f"found {type(error).__name__}: {error}"
            )
            continue
        add(app, point.name, command)
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
        message, context = error.format_message().rstrip("."), getattr(error, "ctx", None)
        if context is not None and error.format_message() == context.get_help():  # no sub-command was given
            typer.echo(context.get_help())
            return 2
        command = "eldir" if context is None else context.command_path
        print_line(f"{_in_plain_words(message)}; see {command} --help")
        return 2
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
        from eldir_app.commands.info import version_lines

        print(version_lines())
        raise typer.Exit
