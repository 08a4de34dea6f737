"""`python -m benchmarks.pulses`: heat of pulses that end by a clock, or by a measurement (decision 59).

A measured pulse ends when the martensite fraction of its spring falls below a threshold, at the latest when
its time is over. The current is the largest that the limits of `eldir_hardware.safety` allow in the worst
corner of the rig file's tolerances. Nothing is measured here: the heat model stands for the rig.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
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
_REST = 0.3  # between two parts of a divided pulse: the contact opens, the timer resets [s]
_MAX_DIVIDED = 15.0  # all parts together: half of a period [s]


class Pulses(NamedTuple):
    """The heating of a spring in every period."""

    heating: float
    """Duration, or longest duration [s]."""
    period: float
    """Period [s]."""
    ends_at: float | None = None
    """Martensite fraction at which a pulse ends; None for timed pulses."""


class Corner(NamedTuple):
    """How far all springs of a rig are off: parts of its tolerances, -1 to 1, and kelvins of transition."""

    current: float = 0.0
    convection: float = 0.0
    room: float = 0.0
    transition: float = 0.0


CORNERS = {
    "as in the file": Corner(), "least current": Corner(-1), "most current": Corner(1),
    "most cooling": Corner(0, 1), "least cooling": Corner(0, -1), "coldest room": Corner(0, 0, -1),
    "warmest room": Corner(0, 0, 1), "transition +5 K": Corner(transition=5),
    "transition -5 K": Corner(transition=-5), "all cold": Corner(-1, 1, -1), "all hot": Corner(1, -1, 1),
}  # fmt: skip
"""The ends of a rig's tolerances: in the template 5 % of the current, 10 % of the cooling, 18 and 30 C."""


def make_rig(
    current: float = 3.6, heating: float = 6.0, timer_margin: float = TIMER_MARGIN, /, **tolerances: float
) -> Rig:
    """The rig of the template with another current [A], longest pulse [s] and cut-off, that much longer [s],
    and other tolerances, also `resistance_tolerance`."""
    values: Any = parse_yaml(virtual_rig().encode(), "template")
    values["supply"]["current_limit_a"] = current
    values["limits"]["max_on_s"] = heating
    values["cutoff"]["max_on_s"] = round(heating + timer_margin, 3)
    for name, value in tolerances.items():
        values["springs" if name == "resistance_tolerance" else "tolerances"][name] = value
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
    try:
        hottest = stuck_temperature(rig, worst, found.final)  # as cold as before the next pulse
    except LimitError:
        return False
    return max(hottest, float(found.temperature.max())) <= rig.limits.max_temperature_c


Allowed = Callable[[Pulses, Rig], bool]


@cache
def max_current(
    pulses: Pulses,
    allowed: Allowed = is_allowed,
    tolerances: tuple[tuple[str, float], ...] = (),
    timer_margin: float = TIMER_MARGIN,
) -> float:
    """The largest current that is allowed, rounded down to a hundredth [A]."""
    low, high = 0, round(_MAX_CURRENT / _CURRENT_STEP)
    while high - low > 1:
        middle = (low + high) // 2
        rig = make_rig(middle * _CURRENT_STEP, pulses.heating, timer_margin, **dict(tolerances))
        low, high = (middle, high) if allowed(pulses, rig) else (low, middle)
    return round(low * _CURRENT_STEP, 2)


class DividedPulse(NamedTuple):
    """A pulse in short parts, repeated until its spring has transformed."""

    current: float
    """Current [A]."""
    parts: int
    """Largest number of parts."""
    stroke: float
    """Part of the stroke in the coldest corner."""
    hottest: float
    """Temperature in the worst corner if the measurement never ends the pulse [C]."""


def divide(part: float, believed: bool) -> DividedPulse:
    """Parts of `part` [s] behind a timer that opens `TIMER_MARGIN` later, at the current that gives most
    stroke in the coldest corner.

    A part begins only if the spring has not transformed, so that a contact that welds then finds no hotter
    one. All parts together must keep the limit without a measurement, unless it is `believed` to end the
    pulse: then they are repeated until the coldest spring has transformed.
    """
    found = DividedPulse(0.0, 0, 0.0, 0.0)
    for current in np.arange(2.0, _MAX_CURRENT, 0.05).round(2).tolist():
        rig = make_rig(current, part)
        worst, coldest = worst_springs(rig), springs_at(rig, CORNERS["all cold"])
        if _peak_if_welded(part, worst) > rig.limits.max_temperature_c:
            break
        for parts in range(1, 1 + int((_MAX_DIVIDED + _REST) / (part + _REST))):
            hottest = _peak_of_parts(part, parts, worst)
            if not believed and hottest > rig.limits.max_temperature_c:
                break
            stroke = 1.0 - _martensite_at(_peak_of_parts(part, parts, coldest, longer=0.0), coldest)
            if stroke > found.stroke + 1e-3:
                found = DividedPulse(current, parts, stroke, hottest)
            if stroke >= 1.0 - TRANSFORMED:
                break
    return found


def _peak_if_welded(part: float, springs: SpringParameters) -> float:
    """Highest temperature of a spring that has just not transformed and rested, and whose contact then stays
    closed until the timer opens [C]."""
    angle = np.arccos(2 * TRANSFORMED - 1) / np.pi
    temperature = springs.austenite_start + angle * (springs.austenite_finish - springs.austenite_start)
    model = HeatModel([springs])
    start = model.cool(SpringState(np.array([temperature]), np.array([TRANSFORMED])), _REST)
    closed = np.ones((round((part + TIMER_MARGIN) / _DT), 1))
    return float(model.run(closed, _DT, start).temperature.max())


def _peak_of_parts(part: float, parts: int, springs: SpringParameters, longer: float = TIMER_STEP) -> float:
    """Highest temperature of a cold spring in all parts, the last of which is `longer` [s, C]."""
    on = np.tile(np.arange(round((part + _REST) / _DT)) < round(part / _DT), parts)
    on = np.append(on[: len(on) - round(_REST / _DT)], np.ones(round(longer / _DT), bool))
    return float(HeatModel([springs]).run(on[:, None], _DT).temperature.max())


def _martensite_at(temperature: float, springs: SpringParameters) -> float:
    """Martensite of a spring that was heated from cold to this temperature and not above. The model would let
    it transform further in each part; a real spring does not before it is hotter than ever."""
    share = (temperature - springs.austenite_start) / (springs.austenite_finish - springs.austenite_start)
    return float((1.0 + np.cos(np.pi * np.clip(share, 0.0, 1.0))) / 2.0)


WAYS = [
    (6.0, 20.0), (6.0, 25.0), (6.0, 30.0), (6.0, 40.0), (6.0, 60.0),
    (2.0, 30.0), (3.0, 30.0), (4.0, 30.0), (8.0, 30.0), (12.0, 40.0),
]  # fmt: skip
"""Longest pulses and periods [s]."""
PARTS = (0.5, 1.0, 2.0, 3.0, 6.0)
"""Parts of divided pulses [s]."""


def main() -> int:
    """Status 0."""
    print("| pulses | current | " + " | ".join(CORNERS) + " |\n| --- | --- |" + " --- |" * len(CORNERS))
    for heating, period in WAYS:
        timed, measured = Pulses(heating, period), Pulses(heating, period, TRANSFORMED)
        believed = max_current(measured, is_allowed_if_measured)
        for name, pulses, current in (
            ("timed", timed, max_current(timed)),
            ("measured", measured, max_current(timed)),
            ("measured and believed", measured, believed),
        ):
            found = " | ".join(f"{mm:.0f}" for mm in strokes(pulses, make_rig(current, heating)))
            print(f"| {name}, {heating:g} s in {period:g} s | {current:.2f} A | {found} |", flush=True)
    print("\n| part | believed | current | parts | stroke, all cold | hottest if it never ends |")
    print("| --- | --- | --- | --- | --- | --- |")
    for part in PARTS:
        for believed_to_end in (False, True):
            d = divide(part, believed_to_end)
            row = f"{d.current:.2f} A | {d.parts} | {d.stroke:.0%} | {d.hottest:.0f} C"
            print(f"| {part:g} s | {'yes' if believed_to_end else 'no'} | {row} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
