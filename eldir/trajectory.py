"""Motion of named points over time, from a rollout or from a camera."""

from __future__ import annotations

from dataclasses import field, replace
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from pydantic import Field, WithJsonSchema

from eldir.core.arguments import require_shape, require_value
from eldir.core.records import Array, BoolArray, FileRecord, FloatArray, record

MAX_TIME_GAP = 0.1
"""Part of a period: a point that was seen so near to an instant has a place there."""
_FRAMES = {"type": "array", "items": {"type": "integer", "minimum": 0}}


@record
class Trajectory(FileRecord):
    """Positions of K points at T instants; NaN where a point was not seen. Raises `InputError` for arrays
    that do not fit each other, and times that decrease."""

    FORMAT = "eldir-trajectory/1"
    OPTIONAL = frozenset({"bridged"})
    MAX_BYTES = 128 << 20  # an hour of five markers at 60 frames a second takes a third of it
    INDENT = None

    names: tuple[str, ...]
    """Names of the points, such as m1 to m5, length K."""
    times: Annotated[FloatArray, Array("f8", None), Field(alias="times_s")]
    """Times [s], shape (T,); they never decrease."""
    positions: Annotated[FloatArray, Array("f8", None, None, 2, gaps=True), Field(alias="positions_m")]
    """Positions [m], x forward and y up, shape (T, K, 2); null in files where a point was not seen."""
    bridged: Annotated[
        BoolArray,
        Array("?", None, None),
        WithJsonSchema({"type": "object", "additionalProperties": _FRAMES}),
    ] = None  # type: ignore[assignment]
    """Whether a position was interpolated between two measured ones, shape (T, K). In files the indices of
    these times for each point that has some."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Origin of the trajectory, for the reader."""

    def __post_init__(self) -> None:
        ordered = (np.diff(self.times) >= 0).all()
        require_value("Trajectory.times", ordered, "finite times that do not decrease [s]")
        shape = (len(self.times), len(self.names))
        if self.bridged is None:
            object.__setattr__(self, "bridged", np.zeros(shape, bool))
        for name, wanted in (("positions", (*shape, 2)), ("bridged", shape)):
            found = getattr(self, name)
            if not found.size and 0 in wanted:  # no list tells the number of points in no frame
                object.__setattr__(self, name, found.reshape(wanted))
            else:
                require_shape(f"Trajectory.{name}", found.shape, wanted)

    def at(self, times: FloatArray) -> Trajectory:
        """The trajectory at other times [s], by linear interpolation; constant before the first and after the
        last time."""
        times = np.asarray(times, dtype=np.float64)
        flat = self.positions.reshape(len(self.times), -1)
        columns = [np.interp(times, self.times, c) for c in flat.T]
        return Trajectory(self.names, times, np.stack(columns, axis=1).reshape(len(times), -1, 2))

    def bridge(self, longest: float = 0.5) -> Trajectory:
        """The trajectory with gaps of up to `longest` [s] filled by linear interpolation, and marked in
        `bridged`.

        Longer gaps stay NaN, and so do positions before the first measurement or after the last."""
        positions, bridged = self.positions.copy(), self.bridged.copy()
        for k in range(len(self.names)):
            seen = np.flatnonzero(np.isfinite(positions[:, k, 0]))
            for a, b in pairwise(seen):
                if b - a > 1 and self.times[b] - self.times[a] <= longest + 1e-9:
                    part = (self.times[a + 1 : b] - self.times[a]) / (self.times[b] - self.times[a])
                    way = positions[b, k] - positions[a, k]
                    positions[a + 1 : b, k] = positions[a, k] + part[:, None] * way
                    bridged[a + 1 : b, k] = True
        return replace(self, positions=positions, bridged=bridged)

    def to_json(self) -> dict[str, Any]:
        """Plain values as in the file."""
        columns = zip(self.names, self.bridged.T, strict=True)
        bridged = {name: np.flatnonzero(column).tolist() for name, column in columns if column.any()}
        return super().to_json() | {"bridged": bridged}

    @classmethod
    def upgrade(cls, values: dict[str, Any]) -> dict[str, Any]:
        """With the bridged frames of each point as an array."""
        bridged = np.zeros((len(values["times_s"]), len(values["names"])), bool)
        for name, frames in values.get("bridged", {}).items():
            bridged[frames, values["names"].index(name)] = True
        return super().upgrade(values | {"bridged": bridged.tolist()})


def interpolate_near(times: FloatArray, values: FloatArray, instants: FloatArray, reach: float) -> FloatArray:
    """Linear interpolation of each column of `values` (T, C), with NaN where a point was not seen, shape
    (instants, C); NaN at an instant from which no value of the column is within `reach` [s]. Before the first
    value and after the last one it is that value."""
    found = np.full((len(instants), values.shape[1]), np.nan)
    for k, column in enumerate(values.T):
        seen = np.isfinite(column)
        if not seen.any():
            continue
        t, after = times[seen], np.searchsorted(times[seen], instants)
        before, after = np.maximum(after - 1, 0), np.minimum(after, len(t) - 1)
        near = np.minimum(np.abs(instants - t[before]), np.abs(instants - t[after])) <= reach
        found[near, k] = np.interp(instants[near], t, column[seen])
    return found


def mean_known(values: FloatArray, axis: int) -> FloatArray:
    """Mean along an axis over the values that are not NaN; NaN where none is."""
    known = np.isfinite(values)
    number, total = known.sum(axis=axis), np.where(known, values, 0.0).sum(axis=axis)
    return np.divide(total, number, out=np.full(np.shape(total), np.nan), where=number > 0)


def height_ranges(heights: FloatArray) -> FloatArray:
    """Greatest minus least of each column (T, C) that has a value, shape (C,); NaN where it has none."""
    found = np.full(heights.shape[1], np.nan)
    some = np.isfinite(heights).any(axis=0)
    if some.any():
        found[some] = np.nanmax(heights[:, some], axis=0) - np.nanmin(heights[:, some], axis=0)
    return found
