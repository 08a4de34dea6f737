"""Motion of named points over time, from a rollout or from a camera."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from eldir.core.files import load_json, write_text
from eldir.core.records import BoolArray, FloatArray, Record
from eldir.errors import InputError

FORMAT = "eldir-trajectory/1"
_LARGEST = 128 << 20  # an hour of five marks at 60 frames a second takes a third of it [bytes]


@dataclass(frozen=True, eq=False)
class Trajectory(Record):
    """Positions of K points at T instants; NaN where a point was not seen. Raises `InputError` for arrays
    that do not fit each other, and times that decrease."""

    names: tuple[str, ...]
    """Names of the points, such as m1 to m5, length K."""
    times: FloatArray
    """Times [s], shape (T,); they never decrease."""
    positions: FloatArray
    """Positions [m], x forward and y up, shape (T, K, 2)."""
    bridged: BoolArray = None  # type: ignore[assignment]
    """Whether a position was interpolated between two measured ones, shape (T, K)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        self._set_array("times", np.float64, (None,))
        if not (np.isfinite(self.times).all() and (np.diff(self.times) >= 0).all()):
            raise InputError("Trajectory.times is wrong", expected="finite times that do not decrease [s]")
        shape = (len(self.times), len(self.names))
        self._set_array("positions", np.float64, (*shape, 2))
        if self.bridged is None:
            object.__setattr__(self, "bridged", np.zeros(shape, bool))
        self._set_array("bridged", np.bool_, shape)

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

    def save(self, path: Path | str, provenance: dict[str, Any] | None = None) -> None:
        """Write as JSON; NaN becomes null. `provenance`: origin of the data, as plain JSON values."""
        flat = [None if np.isnan(v) else v for v in self.positions.ravel().tolist()]
        points = [flat[i : i + 2] for i in range(0, len(flat), 2)]
        marks = len(self.names)
        values = {
            "format": FORMAT,
            "names": list(self.names),
            "times_s": self.times.tolist(),
            "positions_m": [points[i : i + marks] for i in range(0, len(points), marks)],
            "bridged": {
                name: np.flatnonzero(column).tolist()
                for name, column in zip(self.names, self.bridged.T, strict=True)
                if column.any()
            },
            "provenance": provenance or {},
        }
        write_text(Path(path), json.dumps(values, allow_nan=False) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> Trajectory:
        """Read a trajectory. Raises `InputError` for a missing, damaged or foreign file."""
        return load_json(path, FORMAT, cls._from_json, most=_LARGEST)

    @classmethod
    def _from_json(cls, values: dict[str, Any]) -> Trajectory:
        shape = (len(values["times_s"]), len(values["names"]), 2)
        positions = np.array(values["positions_m"], dtype=np.float64).reshape(shape)
        bridged = np.zeros(shape[:2], bool)
        for name, frames in values.get("bridged", {}).items():
            bridged[frames, values["names"].index(name)] = True
        return cls(tuple(values["names"]), values["times_s"], positions, bridged)
