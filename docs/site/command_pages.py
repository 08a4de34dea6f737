"""A page for each command, made from its `--help`: text, options, defaults and examples."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
import typer.core
from generated import plain, write_pages

from eldir_app.application import application


def write(docs: Path) -> None:
    """Write docs/generated/commands/NAME.md for every command that is installed."""
    commands: dict[str, Any] = typer.main.get_command(application()).commands
    pages = {
        f"{name}": "\n\n".join(_section(f"eldir {name}", command, 1)) for name, command in commands.items()
    }
    write_pages(docs / "generated" / "commands", pages)


def _section(name: str, command: Any, depth: int) -> Iterator[str]:
    """The Markdown of a command and of the commands below it."""
    yield f"{'#' * depth} {name}"
    text, _, examples = _split(command.help or "")
    yield text
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [
        p for p in command.params if p.param_type_name == "option" and p.name != "help" and not p.hidden
    ]
    if not hasattr(command, "commands"):
        usage = [
            name,
            *(_usage(a) for a in arguments),
            *(f"{o.opts[0]} {_value(o)}" for o in options if o.required),
        ]
        yield f"```\n{' '.join(usage)}{' [options]' if any(not o.required for o in options) else ''}\n```"
    if examples:
        yield f"Example:\n\n```\n{examples}\n```"
    for title, parameters in (("argument", arguments), ("option", options)):
        if parameters:
            rows = [f"| {title} | value | meaning |", "| --- | --- | --- |", *map(_row, parameters)]
            yield "\n".join(rows)
    for below, inner in getattr(command, "commands", {}).items():
        yield from _section(f"{name} {below}", inner, depth + 1)


def _split(text: str) -> tuple[str, str, str]:
    """The paragraphs of a help text, and its example."""
    body, colon, examples = text.partition("\n\nExample: ")
    paragraphs = [plain(p) for p in body.split("\n\n")]
    return "\n\n".join(paragraphs), colon, examples.strip()


def _usage(argument: Any) -> str:
    name = str(argument.name).upper() + ("..." if argument.nargs != 1 else "")
    return name if argument.required else f"[{name}]"


def _value(parameter: Any) -> str:
    """The value of an option, as in its help; empty for a flag."""
    if getattr(parameter, "is_flag", False):
        return ""
    kind = str(parameter.display_type(typer.Context(typer.core.TyperCommand("eldir")))).strip("<>").lower()
    many = kind.startswith("list[")
    name = str(parameter.metavar or kind.removeprefix("list[").rstrip("]").removesuffix(" range"))
    name = {"str": "text", "int": "number", "float": "number"}.get(name, name)
    info = parameter.type_descriptor.parameter_info
    ends = f" from {info.min}" * (info.min is not None) + f" to {info.max}" * (info.max is not None)
    return name + " ..." * many + ends


def _row(parameter: Any) -> str:
    names = ", ".join(f"`{n}`" for n in [*parameter.opts, *parameter.secondary_opts])
    if parameter.param_type_name == "argument":
        names = f"`{_usage(parameter)}`"
    meaning, default = plain(parameter.help or ""), parameter.default
    if default not in (None, False, True, (), []) and not callable(default) and "Default" not in meaning:
        meaning += f" Default: `{default}`."
    if parameter.required:
        meaning += " **Required.**"
    value = _value(parameter).replace("|", "\\|")
    return f"| {names} | {f'`{value}`' if value else ''} | {meaning} |"
