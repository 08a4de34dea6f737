"""The markers on masses m1 to m5: their colours and size, and the installed kinds of marker.

Kinds are entry points of the group `eldir.markers`, of any package. A package adds a kind with one line in
its pyproject.toml; the name on the left is the value of `marker` in a rig file:

    [project.entry-points."eldir.markers"]
    stars = "my_markers.stars:MARKER"
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.core.arguments import require_known
from eldir.core.records import FloatArray
from eldir.errors import InputError

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
ENTRY_POINT_GROUP = "eldir.markers"
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
    return tuple(sorted(_entry_points(tuple(sys.path))))


def require_kind(kind: str) -> str:
    """The kind itself. Raises `InputError` where it is not installed; does not load it."""
    remedy = "correct the kind, or install the package that provides it"
    require_known("kind of marker", kind, installed_kinds(), remedy)
    return kind


def load_kind(kind: str) -> MarkerKind:
    """The kind of that name. Raises `InputError` where there is none, or it cannot be loaded."""
    point = _entry_points(tuple(sys.path))[require_kind(kind)]
    try:
        found = point.load()
    except (Exception, SystemExit) as error:  # another package's code runs here
        found = error
    if not isinstance(found, MarkerKind):
        raise InputError(
            f"the marker kind {kind} cannot be loaded from {point.value}",
            code="package.broken",
            expected="a eldir_hardware.markers.registration.MarkerKind",
            found=f"{type(found).__name__}: {found}",
            remedy="repair or remove the package that provides it",
        )
    return found


@lru_cache(maxsize=4)
def _entry_points(path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """Entry points by name, of two the first; `path` is the import path on which they were searched. Each rig
    file that is read asks for them, and a search takes longer than the reading."""
    points = list(entry_points(group=ENTRY_POINT_GROUP))
    return {point.name: point for point in reversed(points)}
