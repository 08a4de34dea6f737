"""Measurements of one spring while it is heated and cooled, and samples that are faults of a sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.core.records import BoolArray, FloatArray, Record
from eldir.errors import InputError

_MIN_SAMPLES = 20  # samples
_MAX_START_EXCESS = 8.0  # [K]
_MAX_GAP = 3.0  # times the usual interval
_MAX_SHARE = 0.1
"""A recording with a larger share of such samples is refused."""
_FALSE_ALARM_PROBABILITY = 0.01
"""Probability at which a run of equal values in a whole recording counts as chance."""
_MIN_RUN = 5
_OUTLIER_DEVIATIONS = 6.0  # robust standard deviations
_JUMP_SHARE = 0.2  # a single sample of the current that differs by this part of the peak from both beside it


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
        if len(self.time) < _MIN_SAMPLES:
            raise InputError(
                "the recording is too short",
                code="spring.too-short",
                expected=f"{_MIN_SAMPLES} samples or more",
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
                remedy="check the columns current_a and temperature_c, and the thermocouple",
            )
        if (
            above := float(np.median(self.temperature[:3]) - np.percentile(self.temperature, 5))
        ) > _MAX_START_EXCESS:
            raise InputError(
                "the recording starts with a warm spring, of which the martensite fraction is not known",
                code="spring.warm-start",
                expected=f"a start within {_MAX_START_EXCESS:g} K of its coldest",
                found=f"{above:.1f} K above",
                remedy="let it cool, then record from cold",
            )
        self._require_switches_seen()

    def _require_switches_seen(self) -> None:
        """Raise `InputError` where samples are missing around a change of the current."""
        step = np.diff(self.time)
        change = np.abs(np.diff(self.current)) > 0.5 * self.current.max()
        blind = np.flatnonzero(change & (step > _MAX_GAP * np.median(step)))
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


@dataclass(frozen=True)
class SensorFault:
    """Consecutive samples that are not the spring's."""

    quantity: str
    """temperature, current or length."""
    first_s: float
    last_s: float
    samples: int
    value: float
    """Their median, in the table's unit."""

    def __str__(self) -> str:
        when = (
            f"at {self.first_s:g} s" if self.samples == 1 else f"from {self.first_s:g} to {self.last_s:g} s"
        )
        unit = {"temperature": "C", "current": "A", "length": "mm"}[self.quantity]
        return f"{self.quantity} {when}: {self.samples} x {self.value:.4g} {unit}"


def group_faults(quantity: str, bad: BoolArray, time: FloatArray, values: FloatArray) -> list[SensorFault]:
    """The bad samples of one quantity, consecutive ones together."""
    at = np.flatnonzero(bad)
    runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if len(at) else []
    return [
        SensorFault(quantity, float(time[r[0]]), float(time[r[-1]]), len(r), float(np.median(values[r])))
        for r in runs
    ]


def find_stuck_samples(values: FloatArray) -> BoolArray:
    """Samples in runs of equal values longer than chance explains: a sensor that is stuck or at its limit.

    How often neighbours are equal by chance, because numbers are rounded, is counted in the recording.
    """
    equal = np.concatenate([[False], np.diff(values) == 0.0, [False]])
    chance = float(np.clip(equal.mean(), 1e-6, 1.0 - 1e-6))
    longest = max(_MIN_RUN, 2 + int(np.ceil(np.log(_FALSE_ALARM_PROBABILITY / len(values)) / np.log(chance))))
    edges = np.flatnonzero(np.diff(equal.astype(int)))
    stuck = np.zeros(len(values), bool)
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        stuck[a : b + 1] = b - a + 1 >= longest
    return stuck


def find_outliers(model: FloatArray, measured: FloatArray, noise: float) -> BoolArray:
    """Samples far from the model, where the measured value jumps away from it and back.

    Where it leaves the model without a jump, the model is wrong, or the sensor lags: that is no fault, and
    the residual tells it. A jump is larger than the noise and twice the model's own change.
    """
    residuals = measured - model
    spread = max(1.4826 * float(np.median(np.abs(residuals))), noise)
    far = np.abs(residuals) > _OUTLIER_DEVIATIONS * spread
    jump = np.abs(np.diff(residuals)) > _OUTLIER_DEVIATIONS * noise + 2.0 * np.abs(np.diff(model))
    jump = np.concatenate([[True], jump, [True]])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], far, [False]]).astype(int)))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        far[a:b] = jump[a] and jump[b]
    return far


def find_jumps(current: FloatArray) -> BoolArray:
    """Single samples of the current that differ from both neighbours, which agree."""
    limit = _JUMP_SHARE * float(np.max(current))
    before, here, after = current[:-2], current[1:-1], current[2:]
    jumps = np.zeros(len(current), bool)
    jumps[1:-1] = (np.abs(before - after) < limit / 2) & (np.abs(here - (before + after) / 2) > limit)
    return jumps


def estimate_noise(values: FloatArray) -> float:
    """Standard deviation of the noise in samples (N,), from second differences and from rounding."""
    scatter = 1.4826 * float(np.median(np.abs(np.diff(values, 2)))) / np.sqrt(6.0)
    steps = np.abs(np.diff(values))
    rounding = float(steps[steps > 0].min(initial=np.inf)) / np.sqrt(12.0)
    return max(scatter, rounding if np.isfinite(rounding) else 0.0)


def require_few_faults(faults: list[SensorFault], total: int) -> None:
    """Raise `InputError` where too many samples are faults, with the longest of them."""
    count = sum(f.samples for f in faults)
    if count > _MAX_SHARE * total:
        longest = max(faults, key=lambda f: f.samples)
        raise InputError(
            "too many samples are not those of a heated spring",
            code="spring.faulty-samples",
            expected=f"at most {_MAX_SHARE:.0%} of {total}",
            found=f"{count}, such as {longest}",
            remedy="check the thermocouple and its wires, then record again",
        )
