"""From a design to a schedule for a rig, with the heat and the motion predicted for it.

The rig gives the limits, `eldir.built.gait_search` finds the gait, the compiler makes the schedule.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from eldir.built.gait import CYCLES, Gait
from eldir.built.gait_search import (
    GaitSearchResult,
    HeatingLimits,
    Stage,
    find_gait,
    identified_robots,
    nominal_robots,
    silent,
)
from eldir.built.heat import HeatModel, SpringState, heating_time
from eldir.built.samples import SAMPLES, SampledWalks, interval_reach
from eldir.built.scene import PrintedScene
from eldir.built.screening import candidate_gaits
from eldir.core.pictures import png
from eldir.core.records import FloatArray
from eldir.core.version import __version__
from eldir.design import Design
from eldir.parameters.springs import SpringParameters
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.tolerance_walks import simulate_narrower, simulate_tolerances
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError, power_shares, scale_by_shares
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.safety.limits import DUTY_WINDOW, check_heat, max_pulse
from eldir_hardware.safety.margins import heat_margins
from eldir_hardware.schedule import (
    ActuationSchedule,
    PredictedCycle,
    PredictedWalk,
    Pulse,
)

MAX_PERIOD_S = 120.0
"""Longest period of a gait that is searched [s]."""
_OVERSHOOT = 2.0  # above Af when heated and below Mf when cooled, so that the transformation is complete [K]
_DT = 0.05
_PERIOD_FACTORS = (1.0, 1.25, 1.5, 1.75, 2.0)  # longer periods to try
_MAX_COOLING = 300.0  # longest simulated cooling [s]
_SAMPLE_INTERVAL = 0.5  # between two values in the schedule file [s]


@dataclass(frozen=True)
class PlanConfig:
    """Options of the search for a gait and of its schedule."""

    imitate: bool = False
    """Whether the gait of the neural controller is imitated too, and then chosen."""
    seed: int = 0
    """Random seed of the sampled robots; the same seed gives the same bytes."""
    samples: int = SAMPLES
    """Number of robots for which each walk is predicted, over five cycles."""
    cycles: int = CYCLES
    """Number of cycles of the schedule that count."""
    design_file: str = "design.json"
    """Path from the schedule to the design, from which a virtual rig loads its robot."""
    scene: PrintedScene | None = None
    """Scene identified from films, for whose robots gaits are searched and predicted."""
    air_c: float | None = None
    """Temperature of the air for whose springs the gait is searched [C]; None: that of the rig file."""
    other_than: tuple[Gait, ...] = ()
    """Gaits from which the schedule's must differ, such as filmed ones."""


def plan(
    design: Design,
    rig: Rig,
    config: PlanConfig = PlanConfig(),  # frozen
    on_stage: Stage = silent,
) -> ActuationSchedule:
    """The schedule of a design on this rig, with its predicted walk.

    A filmed gait that walked is kept unless another one is better by the required margin
    (`eldir.built.gait_choice`). Heat limits come from the rig file alone, and so do supply and air of the
    robots of a scene (`PrintedScene.on_rig`). `on_stage` is called with the next stage of the computation.
    Raises `InputError` if the design has more motors than the rig can heat, or the scene other springs;
    `LimitError` if no gait keeps the limits of the rig.
    """
    motors = design.morphology.motors
    rig.require_motors(motors)
    limits = heating_limits(rig, config.air_c)
    _require_quick_springs(limits, motors)
    scene = None if config.scene is None else config.scene.on_rig(limits.springs)
    found = find_gait(
        design,
        limits,
        imitate=config.imitate,
        seed=config.seed,
        samples=config.samples,
        scene=scene,
        other_than=config.other_than,
        stage=on_stage,
    )
    schedule = plan_gait(design, rig, found, replace(config, scene=scene), on_stage)
    # The digest is that of the scene as its file has it.
    return with_digests(schedule, rig, design, config.scene)


def plan_gait(
    design: Design,
    rig: Rig,
    found: GaitSearchResult,
    config: PlanConfig = PlanConfig(),  # frozen
    on_stage: Stage = silent,
) -> ActuationSchedule:
    """The schedule of a gait that was found for this rig, with its predicted walk."""
    limits = heating_limits(rig, config.air_c)
    schedule = compile_schedule(
        found.gait,
        rig,
        tuple(int(s) for s in np.flatnonzero(design.morphology.active)),
        config.cycles,
        {"eldir": __version__, "seed": config.seed, "rig": rig.name, "design": config.design_file},
    )
    on_stage("simulating the ends of the rig's tolerances")
    scene = config.scene
    robots = nominal_robots(design, limits) if scene is None else identified_robots(design, limits, scene)
    predicted = replace(
        schedule.predicted,
        method=found.method,
        displacement=_displacements(found),
        tolerances=simulate_tolerances(robots, found.gait, rig),
        narrower=simulate_narrower(robots, found.gait, schedule, rig),
        cycle=predict_cycle(schedule, rig),
        choice=found.reason or None,
        margins=heat_margins(schedule, rig),
    )
    return with_digests(replace(schedule, predicted=predicted), rig, design, config.scene)


def heating_limits(rig: Rig, air_c: float | None = None) -> HeatingLimits:
    """The limits within which gaits are searched for this rig. `air_c`: temperature of the air around its
    springs [C]; None: that of the rig file. What is allowed is so in all air of the rig's tolerances."""

    def allowed(gait: Gait) -> bool:
        if gait.period > MAX_PERIOD_S:
            return False
        try:
            compile_schedule(gait, rig)
        except LimitError:
            return False
        return True

    @cache
    def timing(springs: SpringParameters, motors: int) -> tuple[float, float]:
        return find_timing(springs, rig, motors)

    springs = rig.spring_parameters().in_air(air_c)
    shared = rig.supply.outputs == "shared"
    shares = tuple(power_shares(rig, springs).tolist()) if shared else ()
    return HeatingLimits(springs, allowed, timing, rig.spring_tolerances(), shares)


def _require_quick_springs(limits: HeatingLimits, motors: int) -> None:
    """Raise `LimitError` if springs need more than `MAX_PERIOD_S` to cool and the usual period is not
    allowed: simulating every gait would take hours."""
    springs = limits.springs
    hot = SpringState(np.array([springs.austenite_finish]), np.zeros(1))
    goal = max(springs.martensite_finish - springs.ambient, 0.5)
    period = float(HeatModel([springs]).cooling_time(hot, goal)[0])
    if period > MAX_PERIOD_S and not limits.allowed(candidate_gaits(motors)[-1]):
        raise LimitError(
            "the springs cool too slowly for a gait",
            code="limit.slow-springs",
            expected=f"a period of at most {MAX_PERIOD_S:g} s",
            found=f"{period:.0f} s until they have cooled",
            remedy="add a fan (entry fan of the rig file), or take thinner wire",
        )


def _displacements(found: GaitSearchResult) -> dict[str, PredictedWalk]:
    """Every gait with its predicted walk, by method."""
    walks = {name: _predicted_walk(gait, found.walks[name]) for name, gait in found.gaits.items()}
    if found.kept_film is not None:
        walks["filmed"] = replace(walks["filmed"], filmed=round(found.kept_film.walked, 6))
    return walks


def _predicted_walk(gait: Gait, walks: SampledWalks) -> PredictedWalk:
    """A gait, and how far samples of the robot walk with it."""
    stands = bool(np.isfinite(walks.mean))
    return PredictedWalk(
        period_s=round(gait.period, 6),
        phase=tuple(round(float(x), 6) for x in gait.phase),
        duty=tuple(round(float(x), 6) for x in gait.duty),
        samples=len(walks.displacement),
        fell=int(np.isinf(walks.displacement).sum()),
        mean=round(walks.mean, 6) if stands else None,
        spread=round(walks.spread, 6) if stands else None,
        probability_forward=walks.probability_forward,
        tie_share=round(walks.tie_share, 6) if np.isfinite(walks.tie_share) else None,
    )


def find_timing(springs: SpringParameters, rig: Rig, motors: int) -> tuple[float, float]:
    """Period [s] and duty with which springs pass Af and are back below Mf, within the limits of the rig.

    If springs would get too hot in the worst corner of the tolerances, first the pauses are lengthened, and
    then the heating is shortened.
    """
    heating = min(heating_time(springs.austenite_finish + _OVERSHOOT, springs), max_pulse(rig))
    period = _shortest_period(heating, springs, rig, motors)
    for slower in _PERIOD_FACTORS:
        if _is_allowed(heating, round(slower * period, 1), rig):
            return round(slower * period, 1), heating / round(slower * period, 1)
    short, long = 0.0, heating
    period = round(_PERIOD_FACTORS[-1] * period, 1)
    while long - short > _DT:
        middle = (short + long) / 2
        short, long = (middle, long) if _is_allowed(middle, period, rig) else (short, middle)
    heating = short or heating  # if none is allowed, the limits refuse it later
    return period, heating / period


def _is_allowed(heating: float, period: float, rig: Rig) -> bool:
    """Whether one channel that heats for `heating` [s] in every period keeps the heat limits."""
    try:
        check_heat([Pulse(rig.channels[0].channel, 0.0, heating)], period, rig)
    except LimitError:
        return False
    return True


def _shortest_period(heating: float, springs: SpringParameters, rig: Rig, motors: int) -> float:
    """Shortest period in which springs cool, and all of them can be heated one after another [s]."""
    steps = math.ceil(heating / _DT)
    on = np.concatenate([np.ones(steps), np.zeros(round(_MAX_COOLING / _DT))])
    temperature = HeatModel([springs]).run(on[:, None], _DT).temperature[steps:, 0]
    goal = max(springs.martensite_finish - _OVERSHOOT, springs.ambient + 0.5)
    cooled = np.flatnonzero(temperature < goal)
    cooling = _DT * (cooled[0] + 1) if len(cooled) else _MAX_COOLING
    current = float(springs.current(0.0)) * (1 + rig.tolerances.current)
    at_once = max(1, int((rig.supply.max_total_current_a + 1e-9) // current))
    if rig.supply.outputs == "shared":
        at_once = 2 * motors
    outputs = 2 * motors // rig.springs_per_channel  # every motor has a spring on both faces
    rounds = math.ceil(outputs / at_once)
    limits = rig.limits
    pause = max(cooling, limits.min_off_s)
    in_a_minute = max(1, int(limits.duty * DUTY_WINDOW / heating + 1e-9))  # whole pulses
    return float(max(heating + pause, DUTY_WINDOW / in_a_minute, rounds * heating))


def predict_cycle(schedule: ActuationSchedule, rig: Rig) -> PredictedCycle:
    """Temperature and free length of the spring on each channel over the last cycle."""
    springs = rig.spring_parameters()
    channels, states = schedule.sampled(_DT)
    on = scale_by_shares(states.astype(np.float64), power_shares(rig, springs))
    history = HeatModel([springs] * len(channels)).run(on, _DT)
    period = round(schedule.period_s / _DT)
    kept = slice(len(states) - period, None, round(_SAMPLE_INTERVAL / _DT))
    begin = _DT * np.arange(0, period, round(_SAMPLE_INTERVAL / _DT))

    def columns(values: FloatArray, scale: float) -> tuple[tuple[float, ...], ...]:
        return tuple(tuple(round(float(scale * x), 2) for x in column) for column in values[kept].T)

    return PredictedCycle(
        t_s=tuple(round(float(t), 3) for t in begin),
        channels=tuple(channels),
        temperature_c=columns(history.temperature, 1.0),
        length_mm=columns(history.length, 1e3),
    )


def draw_heat(schedule: ActuationSchedule) -> bytes:
    """The predicted cycle as PNG: heating, temperatures and free lengths over time."""
    from matplotlib.figure import Figure

    cycle = schedule.predicted.cycle
    if cycle is None:
        raise ValueError("a schedule without a predicted cycle cannot be drawn")
    figure = Figure(figsize=(8, 6), layout="constrained")
    bars, heat, length = figure.subplots(3, 1, sharex=True, height_ratios=[1, 2, 2])
    pulses = schedule.pulses()
    for row, channel in enumerate(schedule.channels):
        for pulse in (p for p in pulses if p.channel == channel):
            for begin in (pulse.start, pulse.start - schedule.period_s):
                bars.barh(row, pulse.length, left=begin, color=f"C{row}")
    bars.set_yticks(range(len(schedule.channels)), [f"channel {c}" for c in schedule.channels])
    for i, channel in enumerate(cycle.channels):
        heat.plot(cycle.t_s, cycle.temperature_c[i], color=f"C{i}", label=f"channel {channel}")
        length.plot(cycle.t_s, cycle.length_mm[i], color=f"C{i}")
    heat.set_ylabel("temperature [C]")
    length.set_ylabel("free length [mm]")
    length.set_xlabel("time in the cycle [s]")
    length.set_xlim(0, schedule.period_s)
    heat.legend(loc="best", fontsize="small")
    figure.suptitle(_make_title(schedule))
    return png(figure)


def _make_title(schedule: ActuationSchedule) -> str:
    if schedule.predicted.walk is None:
        return ""
    walk, fallen = describe_walk(schedule.predicted.walk)
    return f"{schedule.predicted.method}: {walk}\n{fallen}"


def describe_walk(walk: PredictedWalk) -> tuple[str, str]:
    """The predicted displacement of sampled robots in words, and how many of them fall."""
    if walk.mean is None:
        fails = "falls over, folds until parts touch, or buckles a coil"
        return fails, f"all of {walk.samples} sampled robots"
    reach = interval_reach(walk.spread or 0.0, walk.samples - walk.fell)
    interval = (
        ""
        if np.isnan(reach)
        else f", {walk.mean - reach:+.2f} to {walk.mean + reach:+.2f} for 95 % of robots"
    )
    standing = " that stand" if walk.fell else ""
    return (
        f"{walk.mean:+.2f} body lengths per five cycles{interval}{standing}",
        f"of {walk.samples} sampled robots {walk.fell} fall over or fold, "
        f"{walk.probability_forward:.0%} go forward",
    )
