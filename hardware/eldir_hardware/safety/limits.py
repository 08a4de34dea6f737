"""Limits that are checked before heating, for a rig and for a schedule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldir.built.heat import SpringState
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters
from eldir.parameters.wiring import Connection
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError, check_current, power_shares, scale_by_shares, worst_springs
from eldir_hardware.safety.worst_heat import check_board, run_until_periodic, stuck_temperature

if TYPE_CHECKING:  # the guardian starts faster without
    from eldir_hardware.schedule import ActuationSchedule, Pulse

TIMER_STEP = 0.1
"""Possible extension of each pulse: one step of a board's timer, or the time to switch [s]."""
DUTY_WINDOW = 60.0
"""Duration of the windows in which the duty is limited [s]."""
_DT = 0.05
_ROUNDING = 1e-6  # rounding of times [s]


@dataclass(frozen=True)
class HeatPrediction:
    """Modelled temperatures of a schedule, for the hottest springs within the tolerances."""

    peak_c: float
    """Highest temperature [C]."""
    stuck_c: float
    """Highest temperature with a contact welded shut at the worst moment [C]."""


def check_rig(rig: Rig) -> None:
    """Raise `LimitError` for a rig that must not heat at all."""
    worst = worst_springs(rig)
    check_board(rig)
    check_current(rig, 1)
    stuck_temperature(rig, worst, None)


def check_room(rig: Rig, room_c: float | None) -> None:
    """Raise `LimitError` if the measured air [C] is outside of the tolerances that limits are checked for."""
    allowed = rig.tolerances
    if room_c is not None and not allowed.ambient_min_c <= room_c <= allowed.ambient_max_c:
        raise LimitError(
            "the air around the springs is outside of the rig file's tolerances",
            code="limit.room",
            expected=f"{allowed.ambient_min_c:g} to {allowed.ambient_max_c:g} C",
            found=f"{room_c:g} C",
            remedy="change the tolerances in the rig file and make the schedule again: eldir gait",
        )


def check_schedule(schedule: ActuationSchedule, rig: Rig) -> HeatPrediction:
    """Return the prediction of a schedule. Raises `LimitError` if this rig must not play it."""
    check_board(rig)
    for event in schedule.events:
        expected_channel = rig.find_channel(event.spring, event.face)
        if expected_channel != event.channel:
            wired = Connection(event.channel, event.spring, event.face)
            raise LimitError(
                f"channel {event.channel} of the rig does not heat {wired.spring_text}",
                code="limit.other-wiring",
                expected="a spring that this rig heats"
                if expected_channel is None
                else f"channel {expected_channel}",
                remedy="make the schedule again for this rig: eldir gait",
            )
    pulses = schedule.pulses()
    _check_times(pulses, schedule, rig)
    simultaneous = (sum((p.start - q.start) % schedule.period_s < q.length for q in pulses) for p in pulses)
    check_current(rig, max(simultaneous))
    return check_heat(pulses, schedule.period_s, rig)


def check_heat(pulses: list[Pulse], period: float, rig: Rig, longer: float = 0.0) -> HeatPrediction:
    """Raise `LimitError` if pulses that are repeated every `period` [s] heat springs above the limit in the
    worst corner of the tolerances. `longer`: extension of every pulse [s]."""
    worst, max_temperature = worst_springs(rig), rig.limits.max_temperature_c
    parts = power_shares(rig, worst, worst=True)
    planned, late = (on_fractions(pulses, period, longer + extra) for extra in (0.0, TIMER_STEP))
    peak, starts = _temperatures(pulses, period, scale_by_shares(planned, parts), worst, max_temperature)
    _check_peak(peak, rig, "the springs would get too hot")
    # If the computer fails, the board's timer opens a contact up to a step later.
    last, _ = _temperatures(pulses, period, scale_by_shares(late, parts), worst, max_temperature)
    _check_peak(
        last, rig, f"the springs would get too hot if a pulse lasted one step of {TIMER_STEP:g} s longer"
    )
    any_on = np.minimum(late.sum(axis=1), 1.0)
    stuck = stuck_temperature(rig, worst, starts, any_on, period / len(any_on))
    return HeatPrediction(round(peak, 2), round(stuck, 2))


def max_pulse(rig: Rig) -> float:
    """The longest pulse that the rig allows [s]."""
    return min(rig.limits.max_on_s, rig.cutoff_s or np.inf)


def max_on_time(spans: Sequence[tuple[float, float]]) -> float:
    """Longest on-time in any `DUTY_WINDOW` for pulses with these begins and ends [s]."""
    # It is longest in a window that begins or ends with a pulse.
    begins = [a for a, _ in spans] + [b - DUTY_WINDOW for _, b in spans]
    return max((_on_time_in_window(spans, begin) for begin in begins), default=0.0)


def _on_time_in_window(spans: Sequence[tuple[float, float]], begin: float) -> float:
    return sum(max(0.0, min(b, begin + DUTY_WINDOW) - max(a, begin)) for a, b in spans)


def _check_peak(peak: float, rig: Rig, problem: str) -> None:
    if peak > rig.limits.max_temperature_c:
        remedy = "shorten the heating or lower the supply's current limit"
        raise temperature_error(problem, rig, f"{peak:.1f} C predicted", remedy)


def _check_times(pulses: list[Pulse], schedule: ActuationSchedule, rig: Rig) -> None:
    limits = rig.limits
    if not pulses:
        problem, remedy = "the schedule heats nothing", "see eldir gait"
        raise LimitError(problem, code="limit.no-pulse", expected="at least one pulse", remedy=remedy)
    longest, most = max(p.length for p in pulses), max_pulse(rig)
    if longest > most + _ROUNDING:
        raise long_pulse_error("a pulse is too long", rig, longest)
    for pulse in pulses:
        own = [p for p in pulses if p.channel == pulse.channel]
        end = pulse.start + pulse.length
        # Until the next start of the channel, including that of this pulse one period later.
        gap = min((p.start - end - _ROUNDING) % schedule.period_s + _ROUNDING for p in own)
        if gap < limits.min_off_s - 2 * _ROUNDING:
            raise rest_error(pulse.channel, rig, f"{gap:g} s", "lengthen the period")
        repetitions = schedule.period_s * np.arange(int(DUTY_WINDOW / schedule.period_s) + 2)
        on = max_on_time([(p.start + t, p.start + t + p.length) for p in own for t in repetitions])
        if on > limits.duty * DUTY_WINDOW + _ROUNDING:
            raise duty_error(pulse.channel, rig, f"{on:.3g} s", "lengthen the period")


def temperature_error(problem: str, rig: Rig, found: str, remedy: str | None = None) -> LimitError:
    """The error for a spring above the highest allowed temperature."""
    expected = f"at most {rig.limits.max_temperature_c:g} C"
    return LimitError(problem, code="limit.too-hot", expected=expected, found=found, remedy=remedy)


def long_pulse_error(problem: str, rig: Rig, seconds: float) -> LimitError:
    """The error for a pulse that is longer than the rig allows [s]."""
    most, found = f"at most {max_pulse(rig):g} s", f"{seconds:g} s"
    return LimitError(problem, code="limit.long-pulse", expected=most, found=found)


def rest_error(channel: int, rig: Rig, found: str, remedy: str) -> LimitError:
    """The error for a pulse too soon after another one of its channel."""
    problem, least = (
        f"channel {channel} has too little time to cool",
        f"at least {rig.limits.min_off_s:g} s",
    )
    return LimitError(problem, code="limit.no-rest", expected=least, found=found, remedy=remedy)


def duty_error(channel: int, rig: Rig, found: str, remedy: str | None = None) -> LimitError:
    """The error for a channel whose duty is too large."""
    problem = f"the duty of channel {channel} is too large"
    most = f"at most {rig.limits.duty:g} of any {DUTY_WINDOW:g} s"
    return LimitError(problem, code="limit.duty", expected=most, found=found, remedy=remedy)


def on_fractions(pulses: list[Pulse], period: float, extra: float = 0.0) -> FloatArray:
    """Part of each time step for which each channel is closed, shape (steps, channels).

    `extra`: extension of the pulses [s].
    """
    channels = sorted({p.channel for p in pulses})
    steps = max(2, round(period / _DT))
    dt = period / steps
    begin = np.arange(steps) * dt
    on = np.zeros((steps, len(channels)))
    for p in pulses:
        length = min(p.length + extra, period)
        for shift in (0.0, period):  # a pulse may run over the period's end
            overlap = np.minimum(begin + dt, p.start + length - shift) - np.maximum(begin, p.start - shift)
            on[:, channels.index(p.channel)] += np.clip(overlap / dt, 0.0, 1.0)
    return np.minimum(on, 1.0)


def _temperatures(
    pulses: list[Pulse], period: float, on: FloatArray, springs: SpringParameters, max_temperature: float
) -> tuple[float, SpringState]:
    """The highest temperature [C], and the state at the hottest start of each channel's pulses."""
    dt = period / len(on)
    history = run_until_periodic(on, dt, springs, max_temperature)
    temperature, martensite = history.temperature, history.martensite
    starts = []
    for i, channel in enumerate(sorted({p.channel for p in pulses})):
        at = [int(p.start / dt) - 1 for p in pulses if p.channel == channel]
        hottest = max(at, key=lambda k: temperature[k, i])
        starts.append((temperature[hottest, i], martensite[hottest, i]))
    hot, xi = np.array(starts).T
    return float(history.temperature.max()), SpringState(hot, xi)
