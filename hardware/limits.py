"""What must hold before heat is allowed. Nothing here trusts that a contact opens when it is told to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.errors import EldirError
from eldir.sma import SpringParameters, SpringState, heat
from hardware.rig import Rig
from hardware.schedule import ActuationSchedule, Pulse

_DT = 0.05
_PERIODS = 6  # after which temperatures repeat to 0.01 K
_EDGE = 1e-6  # rounding of times [s]


class LimitError(EldirError):
    """Heating is refused."""


@dataclass(frozen=True)
class Prediction:
    """What the model says of a schedule, for the springs that get hottest within the tolerance."""

    peak_c: float
    """Highest temperature [C]."""
    stuck_c: float
    """Highest temperature with a contact welded shut at the worst moment [C]."""


def check(schedule: ActuationSchedule, rig: Rig) -> Prediction:
    """Refuse a schedule that this rig must not play; what is predicted otherwise."""
    worst = worst_springs(rig)
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
    _check_current(pulses, schedule, rig, worst)
    peak, starts = _temperatures(pulses, schedule.period_s, worst)
    ceiling = rig.limits.ceiling_c
    if peak > ceiling:
        raise LimitError(
            "the springs would get too hot",
            expected=f"at most {ceiling:g} C",
            found=f"{peak:.1f} C predicted",
            remedy="shorten the heating or lower the supply's current limit",
        )
    return Prediction(round(peak, 2), round(stuck_temperature(rig, worst, starts), 2))


def worst_springs(rig: Rig) -> SpringParameters:
    """The springs that get hottest within the rig file's tolerance; refused where a measurement is missing.

    A fan counts only where the heating supply is cut by hardware when the fan stands still.
    """
    for name, value in (
        ("springs.resistance_ohm", rig.springs.resistance_ohm),
        ("supply.current_limit_a", rig.supply.current_limit_a),
    ):
        if value is None:
            raise LimitError(
                f"the rig file lacks {name}",
                expected="a measured value",
                remedy="measure it and write it there: without it no temperature can be predicted",
            )
    nominal = rig.spring_parameters(fan=rig.fan is not None and rig.fan.interlocked)
    # At the supply's current limit more resistance means more heat, below it less.
    low, high = (nominal.resistance * (1.0 + s * rig.springs.resistance_tolerance) for s in (-1, 1))
    turning = nominal.supply_voltage / nominal.current_limit - nominal.lead_resistance
    candidates = [low, high, *([turning] if low < turning < high else [])]
    return max((nominal.with_resistance(r) for r in candidates), key=lambda p: float(p.power(0.0)))


def stuck_temperature(rig: Rig, worst: SpringParameters, starts: SpringState | None) -> float:
    """How hot a spring gets when its contact welds shut [C]; refused above the ceiling.

    Safe is (a) a current so small that it settles below the ceiling in still air, or (b) a cut-off
    that the host does not drive. `starts`: springs at the start of their pulses, hottest moments.
    """
    still = rig.spring_parameters(fan=False)
    steady = still.with_resistance(worst.resistance).steady_temperature
    ceiling = rig.limits.ceiling_c
    if steady <= ceiling:
        return steady
    if rig.cutoff is None:
        raise LimitError(
            "a relay contact welded shut would burn its spring",
            expected=f"at most {ceiling:g} C",
            found=f"{steady:.0f} C in still air",
            remedy="lower supply.current_limit_a, or add an independent cut-off to the rig and its file",
        )
    starts = starts or SpringState.cold(1, worst)
    steps = int(np.ceil(rig.cutoff.longest_on_s / _DT))
    held = heat(np.ones((steps, len(starts.temperature))), _DT, worst, starts)
    hottest = float(held.temperature.max())
    if hottest > ceiling:
        raise LimitError(
            "the cut-off would act too late for a relay contact welded shut",
            expected=f"at most {ceiling:g} C",
            found=f"{hottest:.1f} C after {rig.cutoff.longest_on_s:g} s",
            remedy="set it shorter, or lower supply.current_limit_a",
        )
    return hottest


def _check_times(pulses: list[Pulse], schedule: ActuationSchedule, rig: Rig) -> None:
    limits = rig.limits
    if not pulses:
        raise LimitError("the schedule heats nothing", expected="at least one pulse", remedy="see eldir gait")
    longest = max(p.length for p in pulses)
    most = min(limits.longest_on_s, rig.cutoff.longest_on_s if rig.cutoff else np.inf)
    if longest > most + _EDGE:
        raise LimitError("a pulse is too long", expected=f"at most {most:g} s", found=f"{longest:g} s")
    for pulse in pulses:
        others = [p.start for p in pulses if p.channel == pulse.channel]
        end = pulse.start + pulse.length
        # Until the next start of the same channel, its own one a period later included.
        gap = min((s - end - _EDGE) % schedule.period_s + _EDGE for s in others)
        if gap < limits.least_off_s - 2 * _EDGE:
            raise LimitError(
                f"channel {pulse.channel} has too little time to cool",
                expected=f"at least {limits.least_off_s:g} s",
                found=f"{gap:g} s",
                remedy="lengthen the period",
            )


def _check_current(
    pulses: list[Pulse], schedule: ActuationSchedule, rig: Rig, springs: SpringParameters
) -> None:
    one = float(springs.current(0.0))
    if one > rig.board.contact_rating_a:
        raise LimitError(
            "the current exceeds the relay contacts' rating",
            expected=f"at most {rig.board.contact_rating_a:g} A",
            found=f"{one:.1f} A",
        )
    most = max(sum((p.start - q.start) % schedule.period_s < q.length for q in pulses) for p in pulses)
    limit = rig.supply.current_limit_a or one
    if most * limit > rig.supply.budget_a + 1e-9:
        raise LimitError(
            "too many springs heat at once",
            expected=f"at most {rig.supply.budget_a:g} A",
            found=f"{most} x {limit:g} A",
            remedy="move the phases apart",
        )


def _temperatures(pulses: list[Pulse], period: float, springs: SpringParameters) -> tuple[float, SpringState]:
    """The peak over `_PERIODS` periods [C], and the state at the hottest start of each channel's pulses."""
    channels = sorted({p.channel for p in pulses})
    steps = max(2, round(period / _DT))
    dt = period / steps
    begin = np.arange(steps) * dt
    share = np.zeros((steps, len(channels)))
    for p in pulses:
        for shift in (0.0, period):  # a pulse may run over the period's end
            overlap = np.minimum(begin + dt, p.start + p.length - shift) - np.maximum(begin, p.start - shift)
            share[:, channels.index(p.channel)] += np.clip(overlap / dt, 0.0, 1.0)
    history = heat(np.tile(share, (_PERIODS, 1)), dt, springs)
    last = slice((_PERIODS - 1) * steps, None)
    temperature, martensite = history.temperature[last], history.martensite[last]
    starts = []
    for i, channel in enumerate(channels):
        at = [int(p.start / dt) - 1 for p in pulses if p.channel == channel]
        hottest = max(at, key=lambda k: temperature[k, i])
        starts.append((temperature[hottest, i], martensite[hottest, i]))
    hot, xi = np.array(starts).T
    return float(history.temperature.max()), SpringState(hot, xi)
