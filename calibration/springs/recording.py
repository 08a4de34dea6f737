"""Measurements of one spring while it is heated and cooled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.core.records import BoolArray, FloatArray, Record
from eldir.errors import InputError

_LEAST = 20  # samples


@dataclass(frozen=True, eq=False)
class SpringRecording(Record):
    """N samples of one spring; it starts cold, all martensite."""

    time: FloatArray
    """Times [s], ascending, shape (N,)."""
    current: FloatArray
    """Current [A], shape (N,)."""
    voltage: FloatArray
    """Voltage at the spring's ends [V], shape (N,); it counts only while the current flows."""
    temperature: FloatArray
    """Temperature of the spring [C], shape (N,)."""
    fan: BoolArray
    """Whether the fan blew, shape (N,)."""
    length: FloatArray | None = None
    """Free length between centres [m], shape (N,)."""

    def __post_init__(self) -> None:
        self._set_array("time", np.float64, (None,))
        for name in ("current", "voltage", "temperature"):
            self._set_array(name, np.float64, self.time.shape)
        self._set_array("fan", np.bool_, self.time.shape)
        if self.length is not None:
            self._set_array("length", np.float64, self.time.shape)
        if len(self.time) < _LEAST:
            raise InputError(
                "the recording is too short",
                expected=f"{_LEAST} samples or more",
                found=f"{len(self.time)}",
            )
        late = np.flatnonzero(np.diff(self.time) <= 0)
        if len(late):
            raise InputError(
                "the recording's times do not ascend",
                found=f"{self.time[late[0]]:g} s, then {self.time[late[0] + 1]:g} s",
            )
        if not self.heated.any() or np.ptp(self.temperature) < 5.0:
            raise InputError(
                "the recording shows no heating",
                expected="a current, and a temperature that rises by 5 K or more",
                found=f"{np.ptp(self.temperature):.1f} K",
            )

    @property
    def heated(self) -> BoolArray:
        """Whether its current flowed, shape (N,)."""
        return self.current > 0.1 * max(self.current.max(), 1e-9)
