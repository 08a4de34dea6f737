"""Forecast of the highest temperature over all closed and announced pulses, to the end of the last one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from eldir.built.heat import HeatModel, SpringState
from eldir.core.records import FloatArray
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety import limits

HORIZON = 60.0
"""Pulses must end within this time [s]."""
MAX_PULSES = 32
"""Largest number of closed channels and announced pulses."""
_MAX_CHANGE = 8.0  # of a temperature in one part of a step: 0.1 K of error, a quarter of the time [K]
_HEATING_STEP, _COOLING_STEP = 0.5, 4.0  # longest steps while something heats, and while nothing does [s]
_STUCK_STEP = 0.1  # step for a contact that stays closed [s]


class HeatingInterval(NamedTuple):
    """A time for which a channel is closed, or will be."""

    begin: float
    """When it closes, or closed [s on the clock]."""
    channel: int
    end: float
    """When it opens [s on the clock]."""


class Forecast:
    """Temperatures ahead, in the worst corner of the rig's tolerances."""

    def __init__(self, rig: Rig):
        self._channels = [c.channel for c in rig.channels]
        self._worst = limits.worst_springs(rig)
        self._power_shares = limits.power_shares(rig, self._worst, worst=True)
        self._cutoff = rig.cutoff_s
        # A contact that is welded behind a contactor cannot be detected: its spring heats whenever any does.
        self._has_welded_spring = rig.master_channel is not None
        count = len(self._channels) + self._has_welded_spring
        self._model = HeatModel([self._worst] * count, _MAX_CHANGE)

    def predict_peak(self, now: float, state: SpringState, pulses: Sequence[HeatingInterval]) -> float:
        """The highest temperature [C] if each pulse lasts a step longer, or if one of the contacts welds.

        `state`: the springs at `now`, one for each channel of the rig file; with a contactor one more.
        """
        longer = [HeatingInterval(p.begin, p.channel, p.end + limits.TIMER_STEP) for p in pulses]
        instants = {t for p in (*pulses, *longer) for t in (p.begin, p.end) if t > now}
        hottest, at, held = float(state.temperature.max()), now, self._currently_closed(now, state, longer)
        for then in sorted(instants):
            row = self._heating_at(at, pulses, longer)
            steps = int(np.ceil((then - at) / (_HEATING_STEP if row.any() else _COOLING_STEP)))
            history = self._model.run(np.tile(row, (steps, 1)), (then - at) / steps, state)
            hottest, state, at = max(hottest, float(history.temperature.max())), history.final, then
            held += [(self._spring(state, p.channel), self._cutoff) for p in pulses if p.begin == at]
        return max(hottest, self._peak_if_stuck(held))

    def _currently_closed(
        self, now: float, state: SpringState, pulses: Sequence[HeatingInterval]
    ) -> list[tuple[tuple[float, float], float | None]]:
        """The springs of closed channels, each with the time until the timer opens its channel [s]."""
        until = {p: None if self._cutoff is None else self._cutoff + p.begin - now for p in pulses}
        return [(self._spring(state, p.channel), until[p]) for p in pulses if p.begin <= now]

    def _spring(self, state: SpringState, channel: int) -> tuple[float, float]:
        column = self._channels.index(channel)
        return float(state.temperature[column]), float(state.martensite[column])

    def _heating_at(
        self, t: float, pulses: Sequence[HeatingInterval], longer: Sequence[HeatingInterval]
    ) -> FloatArray:
        """Power of each spring from `t` on, as a part of its full power."""
        closed_for_sure = {
            p.channel for p in pulses if p.begin <= t < p.end
        }  # these take their share of a shared supply
        closed = {p.channel for p in longer if p.begin <= t < p.end}
        heated = np.array([c in closed for c in self._channels], dtype=np.float64)
        row = heated * self._power_shares[max(1, len(closed_for_sure))]
        return np.append(row, heated.max()) if self._has_welded_spring else row

    def _peak_if_stuck(self, held: Sequence[tuple[tuple[float, float], float | None]]) -> float:
        """Highest temperature if one of the contacts stays closed until its timer opens [C]."""
        if self._cutoff is None or not held:
            return -np.inf  # without a timer: see `eldir_hardware.safety.worst_heat`
        found = {(t, xi, on) for (t, xi), on in held if on is not None and on > 0}
        if not found:
            return -np.inf
        temperature, martensite, longest = np.array(sorted(found)).T
        begin = _STUCK_STEP * np.arange(int(np.ceil(longest.max() / _STUCK_STEP)))
        on = np.clip((longest - begin[:, None]) / _STUCK_STEP, 0.0, 1.0)
        model = HeatModel([self._worst] * len(found), _MAX_CHANGE)
        return float(model.run(on, _STUCK_STEP, SpringState(temperature, martensite)).temperature.max())


def closed_together(pulses: Sequence[HeatingInterval], slack: float) -> Mapping[float, set[int]]:
    """The channels that are closed at each instant at which one closes."""
    return {
        p.begin: {q.channel for q in pulses if q.begin <= p.begin + slack and q.end > p.begin + slack}
        for p in pulses
    }
