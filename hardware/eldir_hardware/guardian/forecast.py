"""Forecast of the hottest springs over all that is closed and announced, to the end of the last pulse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from eldir.built.heat import HeatModel, SpringState
from eldir.core.records import FloatArray
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety import limits

HORIZON = 60.0
"""Pulses may end at most this far ahead [s]."""
MOST = 32
"""Greatest number of announced pulses."""
_LARGEST_CHANGE = 8.0  # of a temperature in one part of a step: 0.1 K of error, a quarter of the time [K]
_HEATING, _COOLING = 0.5, 4.0  # longest steps while something heats, and while nothing does [s]
_HELD = 0.1  # step for a contact that stays closed [s]


class Heating(NamedTuple):
    """A channel is closed, or will be."""

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
        self._parts = limits.shares(rig, self._worst, worst=True)
        self._cutoff = rig.cutoff_s
        # A contact welded behind a contactor is not seen: its spring heats whenever any does.
        self._welded = rig.master_channel is not None
        count = len(self._channels) + self._welded
        self._model = HeatModel([self._worst] * count, _LARGEST_CHANGE)

    def peak(self, now: float, state: SpringState, pulses: Sequence[Heating]) -> float:
        """Highest temperature [C] if each pulse lasts a step longer, or if any one of the contacts welds.

        `state`: the springs at `now`, one for each channel of the rig file; with a contactor one more.
        """
        longer = [Heating(p.begin, p.channel, p.end + limits.STEP) for p in pulses]
        instants = {t for p in (*pulses, *longer) for t in (p.begin, p.end) if t > now}
        hottest, at, held = float(state.temperature.max()), now, self._closed_now(now, state, longer)
        for then in sorted(instants):
            row = self._row(at, pulses, longer)
            steps = int(np.ceil((then - at) / (_HEATING if row.any() else _COOLING)))
            history = self._model.run(np.tile(row, (steps, 1)), (then - at) / steps, state)
            hottest, state, at = max(hottest, float(history.temperature.max())), history.final, then
            held += [(self._spring(state, p.channel), self._cutoff) for p in pulses if p.begin == at]
        return max(hottest, self._stuck(held))

    def _closed_now(
        self, now: float, state: SpringState, pulses: Sequence[Heating]
    ) -> list[tuple[tuple[float, float], float | None]]:
        """The springs of closed channels, each with the time until the timer opens its channel [s]."""
        until = {p: None if self._cutoff is None else self._cutoff + p.begin - now for p in pulses}
        return [(self._spring(state, p.channel), until[p]) for p in pulses if p.begin <= now]

    def _spring(self, state: SpringState, channel: int) -> tuple[float, float]:
        column = self._channels.index(channel)
        return float(state.temperature[column]), float(state.martensite[column])

    def _row(self, t: float, pulses: Sequence[Heating], longer: Sequence[Heating]) -> FloatArray:
        """How strongly each spring is heated from `t` on."""
        surely = {
            p.channel for p in pulses if p.begin <= t < p.end
        }  # these take their part of a shared supply
        closed = {p.channel for p in longer if p.begin <= t < p.end}
        heated = np.array([c in closed for c in self._channels], dtype=np.float64)
        row = heated * self._parts[max(1, len(surely))]
        return np.append(row, heated.max()) if self._welded else row

    def _stuck(self, held: Sequence[tuple[tuple[float, float], float | None]]) -> float:
        """Highest temperature if one of the contacts stays closed until its timer opens [C]."""
        if self._cutoff is None or not held:
            return -np.inf  # without a timer: see `eldir_hardware.safety.stuck_contact`
        found = {(t, xi, on) for (t, xi), on in held if on is not None and on > 0}
        if not found:
            return -np.inf
        temperature, martensite, longest = np.array(sorted(found)).T
        begin = _HELD * np.arange(int(np.ceil(longest.max() / _HELD)))
        on = np.clip((longest - begin[:, None]) / _HELD, 0.0, 1.0)
        model = HeatModel([self._worst] * len(found), _LARGEST_CHANGE)
        return float(model.run(on, _HELD, SpringState(temperature, martensite)).temperature.max())


def together(pulses: Sequence[Heating], slack: float) -> Mapping[float, set[int]]:
    """The channels that are closed at each instant at which one closes."""
    return {
        p.begin: {q.channel for q in pulses if q.begin <= p.begin + slack and q.end > p.begin + slack}
        for p in pulses
    }
