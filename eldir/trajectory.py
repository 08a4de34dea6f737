"""Motion of named points over time: what a rollout predicts and what a camera saw."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eldir.errors import EldirError, InputError
from eldir.files import read_json, write_text
from eldir.frozen import FloatArray, Record

FORMAT = "eldir-trajectory/1"


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

    def save(self, path: Path | str, provenance: dict[str, Any] | None = None) -> None:
        """Write as JSON; NaN becomes null. `provenance` says where it comes from."""
        flat = [None if np.isnan(v) else v for v in self.positions.ravel().tolist()]
        points = [flat[i : i + 2] for i in range(0, len(flat), 2)]
        marks = len(self.names)
        values = {
            "format": FORMAT,
            "names": list(self.names),
            "times_s": self.times.tolist(),
            "positions_m": [points[i : i + marks] for i in range(0, len(points), marks)],
            "provenance": provenance or {},
        }
        write_text(Path(path), json.dumps(values, allow_nan=False) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> Trajectory:
        """Read a trajectory; a missing, damaged or foreign file is named."""
        values = read_json(Path(path), FORMAT)
        try:
            shape = (len(values["times_s"]), len(values["names"]), 2)
            positions = np.array(values["positions_m"], dtype=np.float64).reshape(shape)
            return cls(tuple(values["names"]), values["times_s"], positions)
        except (EldirError, KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{path} is damaged",
                expected="a trajectory as in docs/schemas/trajectory.schema.json",
                found=f"{type(error).__name__}: {error}",
            ) from None
