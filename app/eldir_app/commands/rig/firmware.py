"""The command `eldir rig firmware`."""

from __future__ import annotations

import math
import re
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from eldir_hardware.rig.configuration import Rig

_FILES = ("channel_limits.py", "limits.py", "main.py", "protocol.py")
_MAX_CHANNELS = 16
_MARGIN_MS = 200  # above the rig's longest pulse, so that the board's own limit does not end it


def firmware(
    *,
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    rig_file: Annotated[
        Path | None, typer.Option("--rig", help="Rig file whose limits the board is to keep.")
    ] = None,
) -> None:
    """Write the MOSFET board's firmware into a folder, to copy onto its microcontroller.

    Example: eldir rig firmware --rig rig.yaml --out firmware
    """
    from eldir.core.files import require_new
    from eldir_hardware.rig.configuration import Rig

    require_new(out)
    _write_firmware(out, None if rig_file is None else Rig.load(rig_file))
    typer.echo(f"wrote {out}; copy its files onto the board: docs/reference/mosfet-board.md")


def _write_firmware(folder: Path, rig: Rig | None = None) -> None:
    """Write the files to copy onto the board into a new folder, with the limits of a rig.

    Raises `InputError` for a rig with more channels than a board has, and if the folder exists.
    """
    from eldir.core.files import new_folder

    source = files("eldir_hardware.firmware")
    with new_folder(folder) as draft:
        for name in _FILES:
            text = source.joinpath(name).read_text()
            if rig is not None and name == "limits.py":
                text = _with_limits(text, rig)
            (draft / name).write_text(text)


def _with_limits(text: str, rig: Rig) -> str:
    """The source of limits.py with the limits of a rig."""
    from eldir.core.arguments import require_value

    channels = rig.board.channels
    require_value("board.channels", channels <= _MAX_CHANNELS, f"at most {_MAX_CHANNELS}", channels)
    steady = () if rig.fan_channel is None else (rig.fan_channel,)
    for name, value in (
        ("PINS", tuple(range(rig.board.channels))),
        ("MAX_ON_MS", math.ceil(1e3 * rig.limits.max_on_s) + _MARGIN_MS),
        ("DUTY_PERCENT", math.ceil(100 * rig.limits.duty - 1e-9)),
        ("STEADY", steady),
    ):
        text, count = re.subn(rf"^{name} = .*$", f"{name} = {value}", text, flags=re.MULTILINE)
        assert count == 1, name
    return text
