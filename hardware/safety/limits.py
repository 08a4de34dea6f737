"""Limits that are checked before heating, for a rig and for a schedule on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.built.heat import HeatModel, SpringState
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters
from hardware.rig.configuration import Rig
from hardware.rig.supply import LimitError, check_current, shared_on, shares, worst_springs
from hardware.safety.stuck_contact import check_board, stuck_temperature
from hardware.schedule import ActuationSchedule, Pulse

STEP = 0.1
"""Every pulse may last this much longer: one step of a board's own timer, or time to switch [s]."""
_DT = 0.05
_PERIODS = 6  # after which temperatures repeat to 0.01 K
_EDGE = 1e-6  # rounding of times [s]


@dataclass(frozen=True)
class Prediction:
    """Modelled temperatures of a schedule, for the springs that get hottest within the tolerance."""

    peak_c: float
    """Highest temperature [C]."""
    stuck_c: float
    """Highest temperature with a contact welded shut at the worst moment [C]."""


def check_rig(rig: Rig) -> None:
    """Raise `LimitError` for a rig that must not heat with any schedule."""
    worst = worst_springs(rig)
    check_board(rig)
    check_current(rig, 1)
    stuck_temperature(rig, worst, None)


def check_schedule(schedule: ActuationSchedule, rig: Rig) -> Prediction:
    """Raise `LimitError` for a schedule that this rig must not play; otherwise return its prediction."""
    worst = worst_springs(rig)
    check_board(rig)
    for event in schedule.events:
        wired = rig.channel_of(event.spring, event.face)
        if wired != event.channel:
            raise LimitError(
                f"spring {event.spring} of the {event.face} face is not on channel {event.channel}",
                expected="no such spring on this rig" if wired is None else f"channel {wired}",
                remedy="make the schedule again for this rig: eldir gait",
            )
    pulses = schedule.pulses()
    _check_times(pulses, schedule, rig)
    together = (sum((p.start - q.start) % schedule.period_s < q.length for q in pulses) for p in pulses)
    check_current(rig, max(together))
    parts = shares(rig, worst, worst=True)
    planned, longer = (_on(pulses, schedule.period_s, more) for more in (0.0, STEP))
    peak, starts = _temperatures(pulses, schedule.period_s, shared_on(planned, parts), worst)
    _check_peak(peak, rig, "the springs would get too hot")
    # If everything dies, a board's own timer opens a contact up to a step later.
    late, _ = _temperatures(pulses, schedule.period_s, shared_on(longer, parts), worst)
    _check_peak(late, rig, f"the springs would get too hot if a pulse lasted one step of {STEP:g} s longer")
    any_on = np.tile(np.minimum(longer.sum(axis=1), 1.0), _PERIODS)
    return Prediction(round(peak, 2), round(stuck_temperature(rig, worst, starts, any_on), 2))


def longest_pulse(rig: Rig) -> float:
    """The longest pulse that the rig allows [s]."""
    return min(rig.limits.longest_on_s, rig.cutoff_s or np.inf)


def _check_peak(peak: float, rig: Rig, problem: str) -> None:
    if peak > rig.limits.ceiling_c:
        raise LimitError(
            problem,
            expected=f"at most {rig.limits.ceiling_c:g} C",
            found=f"{peak:.1f} C predicted",
            remedy="shorten the heating or lower the supply's current limit",
        )


def _check_times(pulses: list[Pulse], schedule: ActuationSchedule, rig: Rig) -> None:
    limits = rig.limits
    if not pulses:
        raise LimitError("the schedule heats nothing", expected="at least one pulse", remedy="see eldir gait")
    longest, most = max(p.length for p in pulses), longest_pulse(rig)
    if longest > most + _EDGE:
        raise LimitError("a pulse is too long", expected=f"at most {most:g} s", found=f"{longest:g} s")
    for pulse in pulses:
        own = [p for p in pulses if p.channel == pulse.channel]
        end = pulse.start + pulse.length
        # Until the next start of the same channel, its own one a period later included.
        gap = min((p.start - end - _EDGE) % schedule.period_s + _EDGE for p in own)
        if gap < limits.least_off_s - 2 * _EDGE:
            raise LimitError(
                f"channel {pulse.channel} has too little time to cool",
                expected=f"at least {limits.least_off_s:g} s",
                found=f"{gap:g} s",
                remedy="lengthen the period",
            )
        duty = sum(p.length for p in own) / schedule.period_s
        if duty > limits.duty + _EDGE:
            raise LimitError(
                f"channel {pulse.channel} heats too large a part of the time",
                expected=f"at most {limits.duty:g}",
                found=f"{duty:.3g}",
                remedy="lengthen the period",
            )


def _on(pulses: list[Pulse], period: float, more: float) -> FloatArray:
    """Fraction of each time step for which each channel is closed, shape (steps, channels)."""
    channels = sorted({p.channel for p in pulses})
    steps = max(2, round(period / _DT))
    dt = period / steps
    begin = np.arange(steps) * dt
    on = np.zeros((steps, len(channels)))
    for p in pulses:
        length = min(p.length + more, period)
        for shift in (0.0, period):  # a pulse may run over the period's end
            overlap = np.minimum(begin + dt, p.start + length - shift) - np.maximum(begin, p.start - shift)
            on[:, channels.index(p.channel)] += np.clip(overlap / dt, 0.0, 1.0)
    return np.minimum(on, 1.0)


def _temperatures(
    pulses: list[Pulse], period: float, on: FloatArray, springs: SpringParameters
) -> tuple[float, SpringState]:
    """The peak over `_PERIODS` periods [C], and the state at the hottest start of each channel's pulses."""
    steps, count = on.shape
    dt = period / steps
    history = HeatModel([springs] * count).run(np.tile(on, (_PERIODS, 1)), dt)
    last = slice((_PERIODS - 1) * steps, None)
    temperature, martensite = history.temperature[last], history.martensite[last]
    starts = []
    for i, channel in enumerate(sorted({p.channel for p in pulses})):
        at = [int(p.start / dt) - 1 for p in pulses if p.channel == channel]
        hottest = max(at, key=lambda k: temperature[k, i])
        starts.append((temperature[hottest, i], martensite[hottest, i]))
    hot, xi = np.array(starts).T
    return float(history.temperature.max()), SpringState(hot, xi)
