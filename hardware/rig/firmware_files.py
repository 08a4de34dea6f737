"""The files of the MOSFET board's firmware, with the limits of a rig file."""

from __future__ import annotations

import math
import re
from importlib.resources import files
from pathlib import Path

from eldir.core.arguments import require_value
from eldir.core.files import new_folder
from hardware.rig.configuration import Rig

FILES = ("channel_limits.py", "limits.py", "main.py", "modulation.py", "protocol.py")
_MOST_CHANNELS = 16
_LONGER_MS = 200  # than the rig's pulses, so that the board ends none of them by its own clock [ms]


def write_firmware(folder: Path, rig: Rig | None = None) -> None:
    """Write the files to copy onto the board into a new folder; `rig`: with the limits of that rig.

    Raises `InputError` for a rig with more channels than a board has, and where the folder exists.
    """
    source = files("hardware.firmware")
    with new_folder(folder) as made:
        for name in FILES:
            text = source.joinpath(name).read_text()
            (made / name).write_text(_limited(text, rig) if rig is not None and name == "limits.py" else text)


def _limited(text: str, rig: Rig) -> str:
    """The limits' file with those of a rig."""
    channels = rig.board.channels
    require_value("board.channels", channels <= _MOST_CHANNELS, f"at most {_MOST_CHANNELS}", channels)
    steady = () if rig.fan_channel is None else (rig.fan_channel,)
    for name, value in (
        ("PINS", tuple(range(rig.board.channels))),
        ("LONGEST_ON_MS", math.ceil(1e3 * rig.limits.longest_on_s) + _LONGER_MS),
        ("DUTY_PERCENT", math.ceil(100 * rig.limits.duty - 1e-9)),
        ("STEADY", steady),
    ):
        text, count = re.subn(rf"^{name} = .*$", f"{name} = {value}", text, flags=re.MULTILINE)
        assert count == 1, name
    return text
