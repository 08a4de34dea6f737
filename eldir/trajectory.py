"""Motion of named points over time: what a rollout predicts and what a camera saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.frozen import FloatArray, Record


@dataclass(frozen=True, eq=False)
class Trajectory(Record):
    """K points at T instants; a point that was not seen is NaN."""

    names: tuple[str, ...]
    """Such as m1 to m5, length K."""
    times: FloatArray
    """[s], increasing, shape (T,)."""
    positions: FloatArray
    """x forward, y up [m], shape (T, K, 2)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        self._set_array("times", np.float64, (None,))
        self._set_array("positions", np.float64, (len(self.times), len(self.names), 2))

    def at(self, times: FloatArray) -> Trajectory:
        """Linear interpolation at other times [s]; ends are held."""
        times = np.asarray(times, dtype=np.float64)
        flat = self.positions.reshape(len(self.times), -1)
        columns = [np.interp(times, self.times, c) for c in flat.T]
        return Trajectory(self.names, times, np.stack(columns, axis=1).reshape(len(times), -1, 2))
