"""The printed robot: its bodies, heated springs, motion, gaits and the search for them.

Devices, schedules and limits of heat are in `hardware`. `build`, `drive` and `walk` are the public functions;
each is imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eldir.built.motion import drive as drive
    from eldir.built.robot import build as build
    from eldir.built.walking import walk as walk

# Where each name is imported from, when it is first used.
_HOMES = {"build": "eldir.built.robot", "drive": "eldir.built.motion", "walk": "eldir.built.walking"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
