"""The ground: flat, or straight segments side by side (paper, Sect. Terrain)."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from eldir.core.arguments import require_value
from eldir.core.records import Array, FileRecord, FloatArray, Record, record
from eldir.errors import InputError

GROUND = 0.1
"""Height of flat ground [m]."""
_LENGTH = (0.02, 0.07)  # of a segment [m]
_SLOPE = (-0.5, 0.5)
_END = 1.25  # where the rugged part stops [m]
_MAX_HEIGHT = 0.5  # the ground stays between 0 and this height [m]
_MAX_TILT = 0.49  # at least 1 % of the slopes then rise, and 1 % fall
_MAX_SAMPLES = 10_000  # for one segment: with a sound generator one of them fits
_DECLINE_START = 0.4  # a descent from 0.1 m would have no room [m]


_Column = Annotated[FloatArray, Array("f8", None)]


@record
class Terrain(Record):
    """Piecewise linear ground. Segment i reaches from x0[i] to x0[i + 1]: height = slope x + intercept.

    The first segment extends to the left and the last to the right.
    """

    x0: _Column
    """Start of each segment [m], increasing, shape (K,)."""
    slope: _Column
    """Slope of each segment, shape (K,)."""
    intercept: _Column
    """Height at x = 0 of each segment's line [m], shape (K,)."""

    def __post_init__(self) -> None:
        if not len(self.x0) == len(self.slope) == len(self.intercept):
            raise ValueError("x0, slope and intercept do not have the same length")
        ordered = len(self.x0) and (np.diff(self.x0) > 0).all()
        require_value("Terrain.x0", ordered, "one or more starts that increase", self.x0.tolist())

    @classmethod
    def flat(cls) -> Terrain:
        """Level ground at 0.1 m."""
        return cls(np.zeros(1), np.zeros(1), np.full(1, GROUND))

    @classmethod
    def from_segments(cls, x0: FloatArray, slope: FloatArray, intercept: FloatArray) -> Terrain:
        """Piecewise linear ground from the arrays of the class."""
        return cls(x0, slope, intercept)

    @classmethod
    def rugged(cls, rng: np.random.Generator, tilt: float = 0.0) -> Terrain:
        """Random rugged ground from x = 0 to 1.25 m, between heights 0 and 0.5 m; level before and behind.

        `tilt` is the mean slope of the sampled segments, from -0.49 to 0.49: 0.2 rises, 0 is level, -0.2
        falls (from 0.4 m). With a steeper one no segment might fit between the heights any more. Raises
        `InputError`.
        """
        remedy = "a steeper plane is Terrain.from_segments with one segment"
        expected = f"{-_MAX_TILT} to {_MAX_TILT}"
        require_value("tilt", -_MAX_TILT <= tilt <= _MAX_TILT, expected, tilt, remedy)
        x, y = 0.0, _DECLINE_START if tilt < 0 else GROUND
        x0, slope, intercept = [], [], []
        while x < _END:
            length, m = _sample_segment(rng, tilt, y)
            x0.append(x)
            slope.append(m)
            intercept.append(y - m * x)
            x, y = x + length, y + m * length
        # Level ground before the first segment and after the last.
        start = _DECLINE_START if tilt < 0 else GROUND
        return cls(
            np.array([x0[0] - 1.0, *x0, x]), np.array([0.0, *slope, 0.0]), np.array([start, *intercept, y])
        )

    @property
    def is_flat(self) -> bool:
        """Whether the whole ground is one level line."""
        return len(self.x0) == 1 and self.slope[0] == 0.0

    def scaled(self, factor: float) -> Terrain:
        """The terrain, this many times as large. A printed robot is `BuiltParameters.scale` times as large as
        a robot of the paper; on the terrain that is scaled so, it meets the same steps."""
        return Terrain(factor * self.x0, self.slope.copy(), factor * self.intercept)

    def height(self, x: FloatArray) -> FloatArray:
        """Height of the ground [m] under each x [m], any shape."""
        x = np.asarray(x, dtype=np.float64)
        segment = np.maximum(np.searchsorted(self.x0, x, side="right") - 1, 0)
        return self.slope[segment] * x + self.intercept[segment]

    def outline(self, first: float, last: float) -> FloatArray:
        """Corners of the surface from `first` to `last` [m], both included: x and height, shape (K, 2)."""
        x = np.array([first, *self.x0[(first < self.x0) & (self.x0 < last)], last])
        return np.stack([x, self.height(x)], axis=1)


@record
class TerrainFile(FileRecord):
    """A terrain as a file of its own, which `eldir evolve --terrain` reads and a packet holds."""

    FORMAT = "eldir-terrain/1"

    robot: Literal["paper", "printed"]
    """Whose metres the lengths are: those of a robot in the paper's scene; or those of the printed robot,
    which is 1.14 times as large (`BuiltParameters.scale`)."""
    terrain: Terrain
    """The ground."""

    def lengths_of(self, robot: Literal["paper", "printed"], scale: float) -> Terrain:
        """The terrain in metres of this robot; `scale`: size of the printed robot over the paper's one."""
        if robot == self.robot:
            return self.terrain
        return self.terrain.scaled(scale if robot == "printed" else 1 / scale)


def _sample_segment(rng: np.random.Generator, tilt: float, start: float) -> tuple[float, float]:
    """Length [m] and slope of a segment that begins at this height [m] and ends between the bounds."""
    for _ in range(_MAX_SAMPLES):
        length, slope = rng.uniform(*_LENGTH), rng.uniform(*_SLOPE) + tilt
        if 0.0 <= start + slope * length <= _MAX_HEIGHT:
            return length, slope
    raise InputError(
        f"no segment of rugged ground fits in {_MAX_SAMPLES} samples", remedy="use another random generator"
    )
