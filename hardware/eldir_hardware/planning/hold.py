"""Holds springs warm: short pulses that repeat, as a schedule to which every limit applies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from eldir.built.heat import austenite_after_loop
from eldir.core.arguments import require_value
from eldir.core.records import FloatArray
from eldir.core.version import __version__
from eldir.design import Design
from eldir.parameters.springs import SpringParameters
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import coldest_springs, power_shares, scale_by_shares
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.safety.limits import on_fractions
from eldir_hardware.safety.worst_heat import describe_early_cutoff, run_until_periodic
from eldir_hardware.schedule import ActuationSchedule

MIN_PULSE = 0.5
"""Shortest pulse and pause [s]; the board is read back within each of them."""
MAX_HOLD = 86_400.0
"""Longest hold [s]."""


class _Pulses(NamedTuple):
    """Pulses of all springs at once: few switchings leave time for read-backs."""

    period: float
    phase: FloatArray
    duty: FloatArray


class HeldTemperatures(NamedTuple):
    """Springs in the periodic state."""

    min_c: float
    """Lowest temperature [C]."""
    max_c: float
    """Highest temperature [C]."""
    stroke: float
    """Part of their stroke that is held at least, whatever repeated swings add to the first one."""


def hold_schedule(
    design: Design,
    rig: Rig,
    power: float,
    seconds: float,
    springs: Sequence[int] = (),
    design_file: str | None = None,
) -> ActuationSchedule:
    """Pulses that heat springs with the mean part `power` of their full power, for at least `seconds` [s].

    `springs`: numbers of active springs; all if empty. The pulses are as short as the rig's
    `min_off_s` and `MIN_PULSE` allow. Raises `LimitError` if a limit of the rig is exceeded.
    """
    motors = design.morphology.motors
    require_value("power", 0 < power < 1, "more than 0 and less than 1", f"{power:g}")
    expected = f"more than 0 and at most {MAX_HOLD:g} s"
    require_value("time", 0 < seconds <= MAX_HOLD, expected, f"{seconds:g}")
    for spring in springs:
        require_value("spring", 0 <= spring < motors, f"0 to {motors - 1}", spring)
    pause = max(rig.limits.min_off_s, MIN_PULSE, MIN_PULSE * (1 - power) / power)
    pause = math.ceil(1e3 * pause - 1e-6) / 1e3
    pulse = round(pause * power / (1 - power), 3)
    period = pause + pulse
    heated = np.isin(np.arange(motors), springs or range(motors))
    schedule = compile_schedule(
        _Pulses(period, np.zeros(motors), heated * pulse / period),
        rig,
        tuple(int(s) for s in np.flatnonzero(design.morphology.active)),
        math.ceil(seconds / period),
        {"eldir": __version__, "rig": rig.name, "design": design_file, "hold": power},
    )
    return with_digests(replace(schedule, conditioning_cycles=0), rig, design)


def hold_temperatures(schedule: ActuationSchedule, rig: Rig, springs: SpringParameters) -> HeldTemperatures:
    """Temperatures of springs in the periodic state of a schedule."""
    on = scale_by_shares(on_fractions(schedule.pulses(), schedule.period_s), power_shares(rig, springs))
    history = run_until_periodic(on, schedule.period_s / len(on), springs, rig.limits.max_temperature_c)
    low, high = float(history.temperature.min()), float(history.temperature.max())
    return HeldTemperatures(low, high, austenite_after_loop(low, high, springs))


def describe_hold(schedule: ActuationSchedule, rig: Rig) -> tuple[str, str]:
    """A sentence on the held temperatures, and a warning that thermal switches open before, else empty."""
    usual, coldest = (
        hold_temperatures(schedule, rig, p) for p in (rig.spring_parameters(), coldest_springs(rig))
    )
    sentence = (
        f"springs are held at {usual.min_c:.0f} to {usual.max_c:.0f} C and at least {usual.stroke:.0%} of "
        f"their stroke; at most {schedule.predicted.peak_c:.0f} C, and at least {coldest.min_c:.0f} C, in "
        "the corners of the rig file's tolerances"
    )
    return sentence, describe_early_cutoff(rig, usual.max_c)
