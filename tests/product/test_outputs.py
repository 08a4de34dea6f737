"""Every command says that it cannot write an output before it reads or computes anything."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from eldir.errors import EldirError
from eldir_app.application import application

OUTPUTS = {
    "out",
    "log",
    "figures",
    "picture",
    "check",
    "sheet",
    "overlay",
    "save_plane",
    "page",
    "compare",
    "trace",
}
"""Names of options that name a file or folder to write."""
INPUTS = {("watch", "log"), ("recover", "log")}
"""Command and option that read such a file."""
ENDINGS = {"picture": ".png", "check": ".png", "sheet": ".pdf", "overlay": ".png", "page": ".html",
           "compare": ".html", "log": ".mcap"}  # fmt: skip
OUT_ENDINGS = {"show": ".webm", "export": ".xml", "recover": ".mcap", "markers": ".pdf"}
"""Commands whose --out has to end so."""
MORE = {
    ("setup", "out"): ["--board", "lcus", "--port", "/dev/null"],
    ("hold", "out"): ["--power", "0.3"],
    ("camera", "out"): ["{input}"],
    ("camera", "picture"): ["{input}", "--out", "{free}"],
    ("runs", "compare"): ["{input}"],
}
"""Arguments that a command needs together with the option."""


def commands(group: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    if not hasattr(group, "commands"):
        yield path, group
        return
    for name, command in group.commands.items():
        yield from commands(command, (*path, name))


def outputs() -> Iterator[Any]:
    """Every command with each of its outputs."""
    names = [name for name in get_command(application()).list_commands(None)]
    for name in names:
        for path, command in commands(get_command(application(name)).commands[name], (name,)):
            for option in command.params:
                if option.name in OUTPUTS and (path[-1], option.name) not in INPUTS:
                    yield pytest.param(path, command, option, id=" ".join([*path, option.opts[0]]))


@pytest.mark.parametrize(("path", "command", "option"), list(outputs()))
def test_an_output_that_cannot_be_written_is_told_before_anything_is_read(
    path: tuple[str, ...], command: Any, option: Any, tmp_path: Path
) -> None:
    """A file stands where a folder is needed; every input is an empty file, which would be an error too."""
    nothing, blocked = tmp_path / "input.json", tmp_path / "file"
    nothing.touch()
    blocked.touch()
    names = {"input": nothing, "free": tmp_path / "free"}
    words = [*path, *(word.format(**names) for word in MORE.get((path[-1], option.name), []))]
    for other in command.params:
        if other is option or not other.required or other.opts[0] in words:
            continue
        is_out = other.name in OUTPUTS
        value = tmp_path / "free" if is_out else nothing
        words += [*other.opts[:1], str(value)] if other.opts[0].startswith("-") else [str(value)]
    ending = OUT_ENDINGS.get(path[-1], "") if option.name == "out" else ENDINGS.get(option.name, "")
    words += [option.opts[0], str(blocked / f"output{ending}")]
    result = CliRunner().invoke(application(path[0]), words)
    assert isinstance(result.exception, EldirError), (result.exception, result.output)
    assert result.exception.code.startswith("file.") and str(blocked) in str(result.exception), (
        result.exception
    )
    assert str(nothing) not in str(result.exception)
