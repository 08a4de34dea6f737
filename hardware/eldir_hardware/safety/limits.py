"""Limits that are checked before heating, for a rig and for a schedule on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldir.built.heat import SpringState
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError, check_current, shared_on, shares, worst_springs
from eldir_hardware.safety.repeated_heat import run_until_repeated
from eldir_hardware.safety.stuck_contact import check_board, stuck_temperature

if TYPE_CHECKING:  # the guardian knows no schedule, and starts faster without
    from eldir_hardware.schedule import ActuationSchedule, Pulse

STEP = 0.1
"""Every pulse may last this much longer: one step of a board's own timer, or time to switch [s]."""
WINDOW = 60.0
"""Time over which the duty counts, wherever it begins [s]."""
_DT = 0.05
_EDGE = 1e-6  # rounding of times [s]


@dataclass(frozen=True)
class Prediction:
    """Modelled temperatures of a schedule, for the springs that get hottest within the tolerances."""

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
    check_board(rig)
    for event in schedule.events:
        wired = rig.channel_of(event.spring, event.face)
        if wired != event.channel:
            raise LimitError(
                f"spring {event.spring} of the {event.face} face is not on channel {event.channel}",
                code="limit.other-wiring",
                expected="no such spring on this rig" if wired is None else f"channel {wired}",
                remedy="make the schedule again for this rig: eldir gait",
            )
    pulses = schedule.pulses()
    _check_times(pulses, schedule, rig)
    together = (sum((p.start - q.start) % schedule.period_s < q.length for q in pulses) for p in pulses)
    check_current(rig, max(together))
    return check_heat(pulses, schedule.period_s, rig)


def check_heat(pulses: list[Pulse], period: float, rig: Rig, longer: float = 0.0) -> Prediction:
    """Raise `LimitError` if pulses that are repeated every `period` [s] heat springs above the ceiling in the
    worst corner of the tolerances. `longer`: every pulse lasts this much longer than given [s]."""
    worst, ceiling = worst_springs(rig), rig.limits.max_temperature_c
    parts = shares(rig, worst, worst=True)
    planned, late = (on_in_period(pulses, period, longer + more) for more in (0.0, STEP))
    peak, starts = _temperatures(pulses, period, shared_on(planned, parts), worst, ceiling)
    _check_peak(peak, rig, "the springs would get too hot")
    # If everything dies, a board's own timer opens a contact up to a step later.
    last, _ = _temperatures(pulses, period, shared_on(late, parts), worst, ceiling)
    _check_peak(last, rig, f"the springs would get too hot if a pulse lasted one step of {STEP:g} s longer")
    any_on = np.minimum(late.sum(axis=1), 1.0)
    stuck = stuck_temperature(rig, worst, starts, any_on, period / len(any_on))
    return Prediction(round(peak, 2), round(stuck, 2))


def longest_pulse(rig: Rig) -> float:
    """The longest pulse that the rig allows [s]."""
    return min(rig.limits.max_on_s, rig.cutoff_s or np.inf)


def most_on(spans: Sequence[tuple[float, float]]) -> float:
    """Longest time that these pulses, each from its begin to its end, take in any `WINDOW` [s]."""
    # The time taken is greatest in a window that begins with a pulse or ends with one.
    begins = [a for a, _ in spans] + [b - WINDOW for _, b in spans]
    return max((_taken(spans, begin) for begin in begins), default=0.0)


def _taken(spans: Sequence[tuple[float, float]], begin: float) -> float:
    return sum(max(0.0, min(b, begin + WINDOW) - max(a, begin)) for a, b in spans)


def _check_peak(peak: float, rig: Rig, problem: str) -> None:
    if peak > rig.limits.max_temperature_c:
        remedy = "shorten the heating or lower the supply's current limit"
        raise too_hot(problem, rig, f"{peak:.1f} C predicted", remedy)


def _check_times(pulses: list[Pulse], schedule: ActuationSchedule, rig: Rig) -> None:
    limits = rig.limits
    if not pulses:
        problem, remedy = "the schedule heats nothing", "see eldir gait"
        raise LimitError(problem, code="limit.no-pulse", expected="at least one pulse", remedy=remedy)
    longest, most = max(p.length for p in pulses), longest_pulse(rig)
    if longest > most + _EDGE:
        raise too_long("a pulse is too long", rig, longest)
    for pulse in pulses:
        own = [p for p in pulses if p.channel == pulse.channel]
        end = pulse.start + pulse.length
        # Until the next start of the same channel, its own one a period later included.
        gap = min((p.start - end - _EDGE) % schedule.period_s + _EDGE for p in own)
        if gap < limits.min_off_s - 2 * _EDGE:
            raise no_rest(pulse.channel, rig, f"{gap:g} s", "lengthen the period")
        again = schedule.period_s * np.arange(int(WINDOW / schedule.period_s) + 2)
        on = most_on([(p.start + t, p.start + t + p.length) for p in own for t in again])
        if on > limits.duty * WINDOW + _EDGE:
            raise beyond_duty(pulse.channel, rig, f"{on:.3g} s", "lengthen the period")


def too_hot(problem: str, rig: Rig, found: str, remedy: str | None = None) -> LimitError:
    """The error for a spring above the ceiling."""
    ceiling = f"at most {rig.limits.max_temperature_c:g} C"
    return LimitError(problem, code="limit.too-hot", expected=ceiling, found=found, remedy=remedy)


def too_long(problem: str, rig: Rig, seconds: float) -> LimitError:
    """The error for a pulse that is longer than the rig allows [s]."""
    most, found = f"at most {longest_pulse(rig):g} s", f"{seconds:g} s"
    return LimitError(problem, code="limit.long-pulse", expected=most, found=found)


def no_rest(channel: int, rig: Rig, found: str, remedy: str) -> LimitError:
    """The error for a pulse too soon after another of its channel."""
    problem, least = (
        f"channel {channel} has too little time to cool",
        f"at least {rig.limits.min_off_s:g} s",
    )
    return LimitError(problem, code="limit.no-rest", expected=least, found=found, remedy=remedy)


def beyond_duty(channel: int, rig: Rig, found: str, remedy: str | None = None) -> LimitError:
    """The error for a channel that heats more than its part of the time."""
    problem = f"channel {channel} heats too large a part of the time"
    most = f"at most {rig.limits.duty:g} of any {WINDOW:g} s"
    return LimitError(problem, code="limit.duty", expected=most, found=found, remedy=remedy)


def on_in_period(pulses: list[Pulse], period: float, more: float = 0.0) -> FloatArray:
    """Part of each time step for which each channel is closed, shape (steps, channels). Pulses last `more`
    seconds longer."""
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
    pulses: list[Pulse], period: float, on: FloatArray, springs: SpringParameters, ceiling: float
) -> tuple[float, SpringState]:
    """The peak of all periods [C], and the state at the hottest start of each channel's pulses."""
    dt = period / len(on)
    history = run_until_repeated(on, dt, springs, ceiling)
    temperature, martensite = history.temperature, history.martensite
    starts = []
    for i, channel in enumerate(sorted({p.channel for p in pulses})):
        at = [int(p.start / dt) - 1 for p in pulses if p.channel == channel]
        hottest = max(at, key=lambda k: temperature[k, i])
        starts.append((temperature[hottest, i], martensite[hottest, i]))
    hot, xi = np.array(starts).T
    return float(history.temperature.max()), SpringState(hot, xi)
