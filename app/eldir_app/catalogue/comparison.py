"""Several filmed runs overlaid: walk, walk in each cycle, heights of the markers, temperatures."""

from __future__ import annotations

import base64
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from eldir.built.gait import CYCLES
from eldir.core.files import write_text
from eldir.core.pictures import hide_frame, new_axes, page_templates, png
from eldir.trajectory import mean_known
from eldir_app.catalogue.listing import signed, version_and_date
from eldir_calibration.comparison.motions import track_run
from eldir_calibration.comparison.recorded_run import LoggedRun, read_run
from eldir_calibration.report.comparison import PHASE_SAMPLES, Motion
from eldir_calibration.report.verdict import RobotLoss

# Okabe and Ito's palette, with a line style for each colour, so that a grey print can be read too.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#8A8A00")
_LINES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)), (0, (3, 1, 1, 1)), (0, (8, 3)))
_MARKERS = "osD^v<>P"


@dataclass(frozen=True)
class ComparedRun:
    """One run with its filmed motion."""

    name: str
    run: LoggedRun
    motion: Motion
    loss: RobotLoss | None = None
    """When the robot fell or got out of sight; None where it did not."""

    @property
    def predicted(self) -> float | None:
        """Walk that the schedule predicts [body lengths per five cycles]."""
        walk = self.run.schedule.predicted.walk
        return None if walk is None else walk.mean


def compared_run(log: Path, progress: Callable[[int, int], None]) -> ComparedRun:
    """A log with its filmed motion, tracked from its pictures. `progress` is called with the number of
    pictures so far, and of all. Raises `InputError` for a log without design, schedule, rig or pictures, or
    one that ends before a whole cycle."""
    run = read_run(log)
    total = run.log.frame_count
    film = track_run(run, lambda frames: progress(frames, total))
    return ComparedRun(str(log), run, film.motion, film.loss)


def write_comparison(runs: Sequence[ComparedRun], page: Path) -> None:
    """Write one HTML file with the figures of all runs and a table of their differences. Logs are named by
    their paths below the folder that they share."""
    paths = [os.path.abspath(one.name) for one in runs]
    shared = os.path.commonpath([os.path.dirname(path) for path in paths])
    runs = [replace(one, name=os.path.relpath(path, shared)) for one, path in zip(runs, paths, strict=True)]
    pictures = [
        (caption, base64.b64encode(png(figure)).decode()) for caption, figure in figures(runs).items()
    ]
    rows = [
        ("robot", [one.run.kind[0] for one in runs]),
        ("rig", [f"{one.run.rig.name}{one.run.physics_note}" for one in runs]),
        ("gait", [f"{one.run.schedule.cycles} x {one.run.schedule.period_s:g} s" for one in runs]),
        ("cycles filmed", [_describe_cycles(one) for one in runs]),
        ("predicted by the schedule", [signed(one.predicted) for one in runs]),
        ("filmed", [signed(one.motion.displacement()) for one in runs]),
        ("filmed, mm in a cycle", [f"{_millimetres(one):+.0f}" for one in runs]),
    ]
    if any(one.loss for one in runs):
        rows.append(("fell or was lost", ["no" if one.loss is None else one.loss.phrase for one in runs]))
    left_out = "" if _have_temperatures(runs) else "temperatures: no log has them"
    text = page_templates("eldir_app.catalogue").get_template("comparison.html").render(
        names=[one.name for one in runs], rows=rows, figures=pictures, left_out=left_out,
        made=version_and_date(),
    )  # fmt: skip
    write_text(page, text)


def _describe_cycles(one: ComparedRun) -> str:
    known, cycles = one.motion.known_cycles, one.motion.cycles
    gaps = "" if known == cycles else f"the walk is known in {known}"
    ending = one.run.ending if one.run.is_incomplete else ""
    return "; ".join(filter(None, (str(cycles), gaps, ending)))


def _millimetres(one: ComparedRun) -> float:
    return 1e3 * one.motion.displacement() * one.motion.body_length / CYCLES


def figures(runs: Sequence[ComparedRun]) -> dict[str, Figure]:
    """A figure for each comparison, by its caption; of temperatures only where a log has them."""
    drawn = {
        "Walk since the start of the cycles that count.": plot_walk(runs),
        "Walk in each cycle. Thin lines: what the schedule predicts.": plot_walk_by_cycle(runs),
        "Heights of the markers over a cycle, mean of all cycles; each run begins with its own schedule.": (
            plot_heights(runs)
        ),
    }
    if _have_temperatures(runs):
        drawn["Modelled temperatures of the springs in the last cycle."] = plot_temperatures(runs)
    return drawn


def _have_temperatures(runs: Sequence[ComparedRun]) -> bool:
    return any(one.run.log.springs for one in runs)


def plot_walk(runs: Sequence[ComparedRun]) -> Figure:
    """Mean forward displacement of the markers [mm] over time [s]."""
    figure, axes = new_axes(7.2, 3.4)
    for k, one in enumerate(runs):
        cycles, moved = one.motion.advance()
        axes.plot(cycles * one.motion.period, 1e3 * moved * one.motion.body_length, **_style(k, one))
    _finish(axes, "time (s)", "walk (mm)")
    return figure


def plot_walk_by_cycle(runs: Sequence[ComparedRun]) -> Figure:
    """Walk of each cycle [body lengths per five cycles]."""
    figure, axes = new_axes(7.2, 3.4)
    for k, one in enumerate(runs):
        moved = one.motion.displacements()
        style = _style(k, one)
        axes.plot(np.arange(1, len(moved) + 1), moved, marker=_MARKERS[k], ms=5, **style)
        if one.predicted is not None:
            axes.axhline(one.predicted, color=style["color"], ls=style["ls"], lw=0.6)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _finish(axes, "cycle", "body lengths per five cycles")
    return figure


def plot_heights(runs: Sequence[ComparedRun]) -> Figure:
    """Height of each marker over a mean cycle [mm], one plot for each marker."""
    names = sorted({name for one in runs for name in one.motion.trajectory.names})
    figure = Figure(figsize=(7.2, 1.2 + 1.3 * len(names)), layout="constrained")
    rows = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    phases = (np.arange(PHASE_SAMPLES) + 0.5) / PHASE_SAMPLES
    for axes, name in zip(rows, names, strict=True):
        for k, one in enumerate(runs):
            markers = one.motion.trajectory.names
            if name in markers:
                heights = one.motion.by_phase()[:, :, markers.index(name), 1]
                whole = np.isfinite(heights).all(axis=1)
                height = mean_known(heights[whole], axis=0)
                axes.plot(phases, 1e3 * height, **_style(k, one))
        _finish(axes, "", f"{name} (mm)", legend=axes is rows[0])
    rows[-1].set_xlabel("part of the cycle")
    return figure


def plot_temperatures(runs: Sequence[ComparedRun]) -> Figure:
    """Temperature of each spring in the last cycle [C], one plot for each spring."""
    names = sorted({name for one in runs for name in one.run.log.springs})
    figure = Figure(figsize=(7.2, 1.2 + 1.3 * len(names)), layout="constrained")
    rows = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(rows, names, strict=True):
        for k, one in enumerate(runs):
            log, motion = one.run.log, one.motion
            begin = motion.start + (motion.cycles - 1) * motion.period
            within = (log.temperature_times >= begin) & (log.temperature_times <= begin + motion.period)
            if name in log.springs:
                shown = log.temperatures[within, log.springs.index(name)]
                axes.plot(log.temperature_times[within] - begin, shown, **_style(k, one))
        _finish(axes, "", f"{name}\n(°C)", legend=axes is rows[0])
    rows[-1].set_xlabel("time since the cycle began (s)")
    return figure


def _style(number: int, one: ComparedRun) -> dict[str, Any]:
    return {"color": _COLOURS[number], "ls": _LINES[number], "lw": 1.3, "label": one.name}


def _finish(axes: Axes, x: str, y: str, legend: bool = True) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    hide_frame(axes)
    axes.grid(alpha=0.25, lw=0.5)
    if legend and axes.get_lines():
        axes.legend(frameon=False, fontsize=8)
