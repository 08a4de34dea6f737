"""The markers on masses m1 to m5: their colours and size, and the installed kinds of marker.

Kinds are entry points of the group `eldir.markers`, of any package. A package adds a kind with one line in
its pyproject.toml; the name on the left is the value of `marker` in a rig file:

    [project.entry-points."eldir.markers"]
    stars = "my_markers.stars:MARKER"
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.core.entry_points import load_registered, registered_names, require_registered
from eldir.core.records import FloatArray

if TYPE_CHECKING:
    from eldir_hardware.markers.tracker import MarkerTracker

DISC_DIAMETER = 0.0105
"""Diameter of every disc [m]."""

PALETTE = {
    "m1": (214, 40, 40),
    "m2": (235, 200, 20),
    "m3": (30, 160, 60),
    "m4": (30, 90, 210),
    "m5": (190, 40, 190),
}
"""sRGB of the disc on each mass: distinct hues identify the markers."""
ENTRY_POINT_GROUP, _WHAT = "eldir.markers", "kind of marker"
DEFAULT_KIND = "discs"
"""The kind of rig files and logs that name none."""


def nominal_bgr(name: str) -> np.ndarray:
    """Colour of a marker as OpenCV orders it, 0 to 255, shape (3,)."""
    return np.array(PALETTE[name][::-1], dtype=np.float64)


Paint = Callable[[str, FloatArray, float], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class MarkerKind:
    """A kind of marker, which an entry point of the group names."""

    tracker: type[MarkerTracker[Any]]
    """Made with plane, names m1, m2, ... and the design's layout."""
    paint: Paint
    """What the printed marker of a name looks like at points (..., 2) from its centre [m], each as wide [m]
    as the last argument says: the part that it covers (...) and its linear reflectance, BGR (..., 3), or the
    same for all colours (..., 1)."""
    width: float
    """Width of the printed marker with its white border [m]."""
    description: str
    """A short description for the printed sheet."""


def installed_kinds() -> tuple[str, ...]:
    """The kinds of marker that are installed, sorted by name."""
    return registered_names(ENTRY_POINT_GROUP)


def require_kind(kind: str) -> str:
    """The kind itself. Raises `InputError` where it is not installed; does not load it."""
    return require_registered(ENTRY_POINT_GROUP, kind, _WHAT)


def load_kind(kind: str) -> MarkerKind:
    """The kind of that name. Raises `InputError` where there is none, or it cannot be loaded."""
    return load_registered(ENTRY_POINT_GROUP, kind, _WHAT, MarkerKind)
