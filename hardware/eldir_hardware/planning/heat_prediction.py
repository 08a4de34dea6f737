"""Predicted temperatures and free lengths of springs under a schedule."""

from __future__ import annotations

import numpy as np

from eldir.built.heat import HeatModel
from eldir.core.pictures import png
from eldir.core.records import FloatArray
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import power_shares, scale_by_shares
from eldir_hardware.schedule import ActuationSchedule, PredictedCycle, PredictedWalk

_DT = 0.05
_SAMPLE_INTERVAL = 0.5  # between two values in the schedule file [s]


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
    return (
        f"{walk.mean:+.2f} +- {walk.spread:.2f} body lengths per five cycles where it stands",
        f"of {walk.samples} sampled robots {walk.fell} fall over or fold, "
        f"{walk.probability_forward:.0%} go forward",
    )
