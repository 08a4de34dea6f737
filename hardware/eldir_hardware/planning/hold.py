"""Holds springs warm: short pulses that repeat, as a schedule to which every limit applies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from eldir.core.arguments import require_value
from eldir.core.records import FloatArray
from eldir.core.version import __version__
from eldir.design import Design
from eldir.parameters.springs import SpringParameters
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import coldest_springs, shared_on, shares
from eldir_hardware.safety.limits import on_in_period
from eldir_hardware.safety.repeated_heat import run_until_repeated
from eldir_hardware.safety.schedule_digests import with_digests
from eldir_hardware.schedule import ActuationSchedule

SHORTEST = 0.5
"""Shortest pulse and pause [s]. The board is asked for its contacts within each of them."""
LONGEST = 86_400.0
"""Longest hold [s]."""


class _Pulses(NamedTuple):
    """All springs at once, so that few switchings leave time to ask the board."""

    period: float
    phase: FloatArray
    duty: FloatArray


class Held(NamedTuple):
    """Springs in the period after which their temperatures repeat."""

    least_c: float
    """Lowest temperature [C]."""
    most_c: float
    """Highest temperature [C]."""
    stroke: float
    """Part of their stroke that they hold at least."""


def hold_schedule(
    design: Design,
    rig: Rig,
    power: float,
    seconds: float,
    springs: Sequence[int] = (),
    design_file: str | None = None,
) -> ActuationSchedule:
    """Pulses that heat springs with a part of their full power on average, for so long at least.

    `springs`: numbers of active springs, all where there are none. The pulses are as short as the rig's
    `min_off_s` and `SHORTEST` allow. Raises `LimitError` where a limit of the rig does not hold.
    """
    motors = design.morphology.motors
    require_value("power", 0 < power < 1, "more than 0 and less than 1", f"{power:g}")
    expected = f"more than 0 and at most {LONGEST:g} s"
    require_value("time", 0 < seconds <= LONGEST, expected, f"{seconds:g}")
    for spring in springs:
        require_value("spring", 0 <= spring < motors, f"0 to {motors - 1}", spring)
    pause = max(rig.limits.min_off_s, SHORTEST, SHORTEST * (1 - power) / power)
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


def held(schedule: ActuationSchedule, rig: Rig, springs: SpringParameters) -> Held:
    """Temperatures of such springs after a long time."""
    on = shared_on(on_in_period(schedule.pulses(), schedule.period_s), shares(rig, springs))
    history = run_until_repeated(on, schedule.period_s / len(on), springs, rig.limits.max_temperature_c)
    temperature = history.temperature
    return Held(float(temperature.min()), float(temperature.max()), float(1 - history.martensite.max()))


def describe(schedule: ActuationSchedule, rig: Rig) -> str:
    """How warm springs are held, in one sentence."""
    usual, coldest = (held(schedule, rig, p) for p in (rig.spring_parameters(), coldest_springs(rig)))
    return (
        f"springs are held at {usual.least_c:.0f} to {usual.most_c:.0f} C and {usual.stroke:.0%} of their "
        f"stroke; at most {schedule.predicted.peak_c:.0f} C, and at least {coldest.least_c:.0f} C, in the "
        "corners of the rig file's tolerances"
    )
