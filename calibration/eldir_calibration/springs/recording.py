"""Measurements of one spring while it is heated and cooled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.core.records import BoolArray, FloatArray, Record
from eldir.errors import InputError

_LEAST = 20  # samples
_COLD = 8.0  # [K]
_GAP = 3.0  # times the usual interval


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
    ambient: FloatArray | None = None
    """Temperature of the surroundings [C], shape (N,)."""

    def __post_init__(self) -> None:
        self._set_array("time", np.float64, (None,))
        for name in ("current", "voltage", "temperature"):
            self._set_array(name, np.float64, self.time.shape)
        self._set_array("fan", bool, self.time.shape)
        for name in ("length", "ambient"):
            if getattr(self, name) is not None:
                self._set_array(name, np.float64, self.time.shape)
        if len(self.time) < _LEAST:
            raise InputError(
                "the recording is too short",
                code="spring.too-short",
                expected=f"{_LEAST} samples or more",
                found=f"{len(self.time)}",
            )
        late = np.flatnonzero(np.diff(self.time) <= 0)
        if len(late):
            raise InputError(
                "the recording's times do not ascend",
                code="spring.wrong-times",
                found=f"{self.time[late[0]]:g} s, then {self.time[late[0] + 1]:g} s",
            )
        if -self.current.min() > self.current.max():
            raise InputError(
                "the current flows backwards",
                code="spring.current-backwards",
                expected="a positive current while the spring is heated",
                found=f"{self.current.min():g} A",
                remedy="turn the clamp round, or change the sign of the column",
            )
        if not self.heated.any() or np.ptp(self.temperature) < 5.0:
            raise InputError(
                "the recording shows no heating",
                code="spring.no-heating",
                expected="a current, and a temperature that rises by 5 K or more",
                found=f"{np.ptp(self.temperature):.1f} K",
            )
        if (above := float(np.median(self.temperature[:3]) - np.percentile(self.temperature, 5))) > _COLD:
            raise InputError(
                "the recording starts with a warm spring, of which the martensite fraction is not known",
                code="spring.warm-start",
                expected=f"a start within {_COLD:g} K of its coldest",
                found=f"{above:.1f} K above",
                remedy="let it cool, then record from cold",
            )
        self._require_switches_seen()

    def _require_switches_seen(self) -> None:
        """Raise `InputError` where samples are missing around a change of the current."""
        step = np.diff(self.time)
        change = np.abs(np.diff(self.current)) > 0.5 * self.current.max()
        blind = np.flatnonzero(change & (step > _GAP * np.median(step)))
        if len(blind):
            raise InputError(
                "samples are missing where the current was switched",
                code="spring.samples-missing",
                expected="samples before and after, as close as elsewhere",
                found=f"none from {self.time[blind[0]]:g} to {self.time[blind[0] + 1]:g} s",
                remedy="record again",
            )

    @property
    def heated(self) -> BoolArray:
        """Whether its current flowed, shape (N,)."""
        return self.current > 0.1 * max(self.current.max(), 1e-9)
