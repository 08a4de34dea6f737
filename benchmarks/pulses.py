"""`python -m benchmarks.pulses`: heat of pulses that end by a clock, or when a spring has transformed (decision 59).

A measured pulse ends when the martensite fraction of its spring falls below a threshold, at the latest when
its time is over. The current is the largest that the limits of `eldir_hardware.safety` allow in the worst
corner of the rig file's tolerances. Nothing is measured here: the heat model stands for the rig.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from math import floor
from typing import Any, NamedTuple

import numpy as np

from eldir.built.heat import HeatModel, SpringHistory, SpringState
from eldir.core.records import BoolArray, FloatArray
from eldir.core.validation import validate
from eldir.core.yaml_files import parse_yaml
from eldir.parameters.springs import SpringParameters
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError, springs_at_tolerances, worst_springs
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.safety.limits import TIMER_STEP, check_heat
from eldir_hardware.safety.worst_heat import stuck_temperature
from eldir_hardware.schedule import Pulse

TRANSFORMED = 0.05
"""Martensite fraction at which a measured pulse ends."""
TIMER_MARGIN = 0.3
"""The cut-off opens so long after the longest pulse [s], as in the template."""
_DT = 0.05  # of the simulation, and between two measurements [s]
_PERIODS = 5  # until temperatures repeat
_MAX_CURRENT, _CURRENT_STEP = 6.0, 0.01  # of the search [A]
_REST = 0.3  # between two parts of a divided pulse: the board opens, the timer resets [s]


class Pulses(NamedTuple):
    """The heating of a spring in every period."""

    heating: float
    """Duration, or longest duration [s]."""
    period: float
    """Period [s]."""
    ends_at: float | None = None
    """Martensite fraction at which a pulse ends; None for timed pulses."""


class Corner(NamedTuple):
    """Parts of the rig's tolerances by which all springs are off, -1 to 1, and kelvins of their transition."""

    current: float = 0.0
    convection: float = 0.0
    room: float = 0.0
    transition: float = 0.0


CORNERS = {
    "as in the file": Corner(), "current -5 %": Corner(-1), "current +5 %": Corner(1),
    "cooling +10 %": Corner(0, 1), "cooling -10 %": Corner(0, -1), "18 C": Corner(0, 0, -1),
    "30 C": Corner(0, 0, 1), "transition +5 K": Corner(transition=5), "transition -5 K": Corner(transition=-5),
    "all three cold": Corner(-1, 1, -1), "all three hot": Corner(1, -1, 1),
}  # fmt: skip
"""The rows of the tables, named for the tolerances of the template."""


def make_rig(
    current: float = 3.6, heating: float = 6.0, cutoff: float | None = None, **tolerances: float
) -> Rig:
    """The rig of the template with another current [A], longest pulse and cut-off [s], and tolerances."""
    values: Any = parse_yaml(virtual_rig().encode(), "template")
    values["supply"]["current_limit_a"] = current
    values["limits"]["max_on_s"] = heating
    values["cutoff"]["max_on_s"] = round(heating + TIMER_MARGIN if cutoff is None else cutoff, 3)
    values["tolerances"] |= tolerances
    return validate(Rig, values, "rig", "")


def springs_at(rig: Rig, corner: Corner) -> SpringParameters:
    """Springs of a rig that is off by these parts of its tolerances."""
    return shift(springs_at_tolerances(rig, rig.spring_parameters(), *corner[:3]), corner.transition)


def shift(springs: SpringParameters, kelvins: float) -> SpringParameters:
    """Springs with other transition temperatures."""
    names = ("austenite_start", "austenite_finish", "martensite_start", "martensite_finish")
    return replace(springs, **{name: getattr(springs, name) + kelvins for name in names})


def heat_measured(
    planned: BoolArray, springs: Sequence[SpringParameters], ends_at: float | None, dt: float = _DT
) -> SpringHistory:
    """Cold springs in the planned pulses, shape (T, A), each of which ends early once the martensite fraction
    of its own spring is below `ends_at`. The fraction is measured at the end of each step of `dt` [s]."""
    model = HeatModel(springs)
    state = SpringState(np.array([p.ambient for p in springs]), np.ones(len(springs)))
    if ends_at is None:
        return model.run(planned, dt, state, many=True)
    ended, found = np.zeros(len(springs), bool), []
    for row in planned:
        ended &= row  # a contact that was to be open ends the pulse
        step = model.run((row & ~ended)[None], dt, state, many=True)
        found.append(step)
        state = step.final
        ended |= row & (state.martensite < ends_at)
    names = ("temperature", "martensite", "length", "current")
    return SpringHistory(*(np.concatenate([getattr(step, name) for step in found]) for name in names))


def last_period(pulses: Pulses, springs: Sequence[SpringParameters]) -> SpringHistory:
    """The last of some periods, of springs that began cold; pulses begin at its start."""
    steps = round(pulses.period / _DT)
    on = np.zeros((steps, len(springs)), bool)
    on[: round(pulses.heating / _DT)] = True
    history = heat_measured(np.tile(on, (_PERIODS, 1)), springs, pulses.ends_at)
    last = (getattr(history, name)[-steps:] for name in ("temperature", "martensite", "length", "current"))
    return SpringHistory(*last)


def strokes(pulses: Pulses, rig: Rig) -> FloatArray:
    """Free stroke of a spring in each corner [mm], shape (corners,)."""
    found = last_period(pulses, [springs_at(rig, corner) for corner in CORNERS.values()])
    return 1e3 * np.ptp(found.length, axis=0)


def is_allowed(pulses: Pulses, rig: Rig) -> bool:
    """Whether the limits allow timed pulses of the full length, also with a contact that welds shut."""
    try:
        check_heat([Pulse(1, 0.0, pulses.heating)], pulses.period, rig)
    except LimitError:
        return False
    return True


def is_allowed_if_measured(pulses: Pulses, rig: Rig) -> bool:
    """The same if the measurement is believed until a contact welds shut: that spring was as cold as measured
    pulses leave it."""
    worst = worst_springs(rig)
    found = last_period(pulses, [worst])
    start = found.final  # coldest moment: just before the next pulse
    try:
        hottest = stuck_temperature(rig, worst, start)
    except LimitError:
        return False
    return max(hottest, float(found.temperature.max())) <= rig.limits.max_temperature_c


Allowed = Callable[[Pulses, Rig], bool]


@cache
def max_current(
    pulses: Pulses, allowed: Allowed = is_allowed, tolerances: tuple[tuple[str, float], ...] = ()
) -> float:
    """The largest current that is allowed, rounded down to a hundredth [A]."""
    low, high = 0, round(_MAX_CURRENT / _CURRENT_STEP)
    while high - low > 1:
        middle = (low + high) // 2
        rig = make_rig(middle * _CURRENT_STEP, pulses.heating, **dict(tolerances))
        low, high = (middle, high) if allowed(pulses, rig) else (low, middle)
    return round(low * _CURRENT_STEP, 2)


class DividedPulse(NamedTuple):
    """A pulse that is repeated after a short rest until its spring has transformed."""

    part: float
    """Duration of each part [s]; the cut-off opens `TIMER_MARGIN` later."""
    current: float
    """Largest current at which a contact that welds at the start of a part is harmless [A]."""
    coldest: float
    """Largest part of the stroke in the coldest corner, however long it is heated."""
    coldest_time: float
    """Time until it is transformed in the coldest corner [s]; infinite if never."""
    not_ended: float
    """Highest temperature in the worst corner if the measurement says that it never transforms, and parts are
    repeated for that time, or a minute [C]."""


def divide(part: float) -> DividedPulse:
    """A divided pulse at the largest current at which a contact that welds is harmless if the measurement is
    true: every part begins with a spring that has not transformed."""

    def welded(rig: Rig) -> bool:
        worst = worst_springs(rig)
        # The hottest spring that has not transformed after a part: it was just not at the threshold.
        angle = np.arccos(2 * TRANSFORMED - 1) / np.pi
        temperature = worst.austenite_start + angle * (worst.austenite_finish - worst.austenite_start)
        start = HeatModel([worst]).cool(SpringState(np.array([temperature]), np.array([TRANSFORMED])), _REST)
        held = np.ones((round((part + TIMER_MARGIN) / _DT), 1))
        hottest = HeatModel([worst]).run(held, _DT, start).temperature.max()
        return bool(hottest <= rig.limits.max_temperature_c)

    low, high = 0, round(_MAX_CURRENT / _CURRENT_STEP)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if welded(make_rig(middle * _CURRENT_STEP, part)) else (low, middle)
    rig = make_rig(low * _CURRENT_STEP, part)
    cycle = np.arange(round(60.0 / _DT)) * _DT % (part + _REST)
    on = (cycle < part - 1e-9)[:, None]
    cold = HeatModel([springs_at(rig, CORNERS["all three cold"])]).run(on, _DT)
    below = np.flatnonzero(cold.martensite[:, 0] < TRANSFORMED)
    time = _DT * (below[0] + 1) if len(below) else np.inf
    hot = HeatModel([worst_springs(rig)]).run(on[: round(min(time, 60.0) / _DT)], _DT)
    least = float(cold.martensite.min())
    return DividedPulse(part, round(low * _CURRENT_STEP, 2), 1 - least, time, float(hot.temperature.max()))


WAYS = [
    (6.0, 20.0), (6.0, 25.0), (6.0, 30.0), (6.0, 40.0), (6.0, 60.0),
    (2.0, 30.0), (3.0, 30.0), (4.0, 30.0), (8.0, 30.0), (12.0, 40.0),
]  # fmt: skip
"""Longest pulses and periods [s]."""


def main() -> int:
    """Status 0."""
    print("| pulses | current | " + " | ".join(CORNERS) + " |\n| --- | --- |" + " --- |" * len(CORNERS))
    for heating, period in WAYS:
        measured = Pulses(heating, period, TRANSFORMED)
        for name, pulses, allowed in (
            ("timed", Pulses(heating, period), is_allowed),
            ("measured", measured, is_allowed),
            ("measured and believed", measured, is_allowed_if_measured),
        ):
            rule = pulses if allowed is is_allowed_if_measured else Pulses(heating, period)
            current = max_current(rule, allowed)
            found = " | ".join(f"{mm:.0f}" for mm in strokes(pulses, make_rig(current, heating)))
            print(f"| {name}, {heating:g} s in {period:g} s | {current:.2f} A | {found} |", flush=True)
    print("\n| part | current | stroke, all three cold | transformed after | hottest if never measured |")
    print("| --- | --- | --- | --- | --- |")
    for part in (0.5, 1.0, 2.0, 3.0, 6.0):
        d = divide(part)
        print(f"| {part:g} s | {d.current:.2f} A | {d.coldest:.0%} | {d.coldest_time:.1f} s | {d.not_ended:.0f} C |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
