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
from eldir_app.commands import add_command, command_names, load_command

GROUP = "eldir.commands"
"""Entry points by which other packages add sub-commands."""
_logger = logging.getLogger(__name__)
_INSTALL_COMPLETION = "--install-completion"
_PLAIN_WORDS = (
    ("Input should be greater than or equal to ", "expected at least "),
    ("Input should be less than or equal to ", "expected at most "),
    ("Input should be a valid integer.*", "expected a whole number"),
    ("Input should be a valid number.*", "expected a number"),
    ("Value error, ", ""),
    ("Input should be ", "expected "),
)


class _InterruptedError(Exception):
    """Ctrl-C, past Typer, which would exit without a message."""


class _Commands(TyperGroup):
    """Commands that report Ctrl-C, all have the option -v, and name types in the words of a shell."""

    def __init__(self, **values: Any):
        super().__init__(**values)
        verbose = [option for option in self.params if option.name == "verbose"]
        pending = list(self.commands.values())
        while pending:
            command = pending.pop()
            pending += getattr(command, "commands", {}).values()
            if not any("-v" in option.opts for option in command.params):  # another package's own -v
                command.params += verbose
            for parameter in command.params:
                _name_type_of_elements(parameter)

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise _InterruptedError from None


def _name_type_of_elements(parameter: Any) -> None:
    """Of an option that may be repeated, help shows the type of one value: <path>, not <list[Path]>."""
    display_type = parameter.display_type
    parameter.display_type = lambda context: re.sub(
        r"list\[(\w+)\]", lambda found: found[1].lower(), display_type(context)
    )


def application(only: str = "") -> typer.Typer:
    """The command with our sub-commands and those of other packages (entry-point group `eldir.commands`).

    `only`: the one sub-command to load, if it is ours.
    """
    # Plain help: for markup, Typer imports rich's Markdown, which takes half of the time of `eldir --help`.
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
                callback=_raise_verbosity,
                expose_value=False,
                show_default=False,
                help="Write on stderr what the program does; -vv also every frame from and to the devices.",
            ),
        ] = 0,
    ) -> None:
        """From an evolved robot in simulation to the same robot walking on a table.

        Example: eldir demo --out demo
        """

    ours = command_names(commands.__name__, commands.ORDER)
    for name in [only] if only in ours else ours:
        add_command(app, name, load_command(commands.__name__, name))
    if only not in ours:
        _add_commands_of_other_packages(app)
    return app


def _add_commands_of_other_packages(app: typer.Typer) -> None:
    for point in sorted(entry_points(group=GROUP), key=lambda p: p.name):
        try:
            command = point.load()
        except (Exception, SystemExit) as error:  # `eldir rig off` must work beside a broken package
            _logger.warning(
                f"the command {point.name} cannot be loaded from {point.value}; "
                f"found {type(error).__name__}: {error}"
            )
            continue
        add_command(app, point.name, command)


def run_application() -> int:
    """Run the command; return its exit status. Raises `EldirError`, and `KeyboardInterrupt` for Ctrl-C."""
    # Where the home folder is read-only, Matplotlib warns in three lines that it uses another folder.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    program_log.read_levels()  # raises for invalid ones
    _configure_log()
    try:
        name = next((argument for argument in sys.argv[1:] if not argument.startswith("-")), "")
        status = application(name)(standalone_mode=False, prog_name="eldir")
    except TyperException as error:  # invalid arguments
        message, context = error.format_message().rstrip("."), getattr(error, "ctx", None)
        if context is not None and error.format_message() == context.get_help():  # no sub-command was given
            typer.echo(context.get_help())
            return 2
        command = "eldir" if context is None else context.command_path
        print_line(f"{_in_plain_words(message)}; see {command} --help")
        return 2
    except (typer.Abort, _InterruptedError):
        raise KeyboardInterrupt from None
    except OSError as error:
        if _INSTALL_COMPLETION not in sys.argv:
            raise
        raise EldirError(
            f"cannot install completion: {error}", remedy="put the lines of --show-completion there yourself"
        ) from None
    return status if isinstance(status, int) else 0


def _in_plain_words(message: str) -> str:
    """A message about an argument, without the jargon of pydantic."""
    for pattern, replacement in _PLAIN_WORDS:
        message = re.sub(pattern, replacement, message)
    return message


def _raise_verbosity(steps: int) -> None:
    """The option -v, before or after the name of the sub-command."""
    if steps:
        program_log.raise_level(steps)
        _configure_log()


def _configure_log() -> None:
    """Plain lines; with -v on a terminal, Rich's."""
    if program_log.is_detailed() and os.isatty(2):
        from rich.console import Console
        from rich.logging import RichHandler

        console = Console(file=cast("IO[str]", program_log.UnblockedStderr()))
        handler = RichHandler(
            console=console, omit_repeated_times=False, show_path=False, log_time_format="%H:%M:%S.%f"
        )
        handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
        program_log.configure("eldir", handler)
    else:
        program_log.configure("eldir")


def _print_version(requested: bool) -> None:
    if requested:
        from eldir_app.commands.info import version_lines

        print(version_lines())
        raise typer.Exit
