"""The report of an adaptation: one page in its folder, with the films of its runs beside each other."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from eldir.built.gait import describe_loss
from eldir.built.scene import PrintedScene
from eldir.built.walking import describe_doubt
from eldir.core.files import write_bytes, write_text
from eldir.core.pictures import new_axes, page_templates, png
from eldir.core.version import __version__
from eldir.design import Design
from eldir.errors import EldirError
from eldir.parameters.robot import QUANTITIES, RobotParameters
from eldir.parameters.uncertain import PARAMETERS
from eldir_calibration.adaptation.prior import BELIEF
from eldir_calibration.adaptation.runs import Adaptation, AdaptationRun
from eldir_calibration.comparison.film import render_film
from eldir_calibration.comparison.predictions import predict_body
from eldir_calibration.comparison.recorded_run import open_run
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.identification.identification import RobotFilms
from eldir_calibration.report.comparison import Motion
from eldir_hardware.planning.compiler import extract_gait
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.vision.recording_setup import find_recorded_plane
from eldir_hardware.vision.sources import LoggedFrames

PAGE = "adaptation.html"
_FILM, _REPORT = "film.webm", "report/index.html"
_BEFORE, _AFTER, _FILMED = "#E69F00", "#0072B2", "#000000"
_UNSEEN = {parameter.quantity for parameter in PARAMETERS.values() if parameter.unobservable}
_HALF_WIDTH = DEFAULT_CONFIG.interval


class QuantityRow(NamedTuple):
    """A quantity of the robot, before and after the films."""

    name: str
    unit: str
    before: float
    before_interval: tuple[float, float]
    after: float
    after_interval: tuple[float, float]
    left: float
    """Width of the interval after the films, as a part of that before."""


class RunRow(NamedTuple):
    """A run as the page shows it."""

    number: int
    run: AdaptationRun
    schedule: ActuationSchedule
    interval: tuple[float, float] | None
    """95 % interval of the predicted walk [body lengths per five cycles]; None if all samples fell."""
    film: str | None
    """Path of its film; None if there is none."""
    report: str | None
    """Path of its own report; None if nobody made one."""

    @property
    def heating(self) -> str:
        """Its gait: when each motor is heated, in each period."""
        gait = extract_gait(self.schedule)
        if gait is None:
            return "no gait"
        parts = [
            f"{p:.1f} to {p + d:.1f} s"
            for p, d in zip(gait.phase * gait.period, gait.duty * gait.period, strict=True)
        ]
        return f"{', '.join(parts)} of {gait.period:.0f} s"

    @property
    def reason(self) -> str:
        """Why this gait was chosen, and whether chance decides its walk."""
        predicted = self.schedule.predicted
        chosen = predicted.choice or "the gait with which robots of the kit are predicted to walk farthest"
        doubt = "" if predicted.walk is None else describe_doubt(predicted.walk.tie_share)
        return f"{chosen}; {doubt}" if doubt else chosen


def write_film(log: Path, design: Design, film: RobotFilms) -> None:
    """Write the film of a run beside its log, with the body as it was predicted before the run drawn in,
    unless it is there already. Logs without pictures, and predictions that blow up, have no film."""
    target, belief = log.with_name(_FILM), log.with_name(BELIEF)
    if target.exists():
        return
    run = open_run(log, design)
    if not run.log.frame_count:
        return
    try:
        body = predict_body(run, PrintedScene.load(belief) if belief.exists() else None)
    except EldirError:  # it blew up
        return
    (seen,) = film.recordings
    motion = Motion(seen.tracked, seen.start, seen.period, seen.cycles, run.robot.body_length)
    plane = find_recorded_plane(LoggedFrames(run.log))
    write_bytes(target, render_film(run.log, plane, motion, body))


def write_page(
    folder: Path,
    nominal: RobotParameters,
    found: Adaptation,
    prior: PrintedScene | None,
    belief: PrintedScene,
) -> None:
    """Write `adaptation.html` into the folder of an adaptation.

    Args:
        nominal: the robot of which the parameters are deviations.
        found: the runs so far; `ended` is empty while it goes on.
        prior: what other robots of the kit told before the films, if anything.
        belief: what is believed after the films.
    """
    rows = [_run_row(folder, number, run) for number, run in enumerate(found.runs, start=1)]
    quantities = quantity_rows(nominal, prior, belief)
    templates = page_templates(
        "eldir_calibration.adaptation",
        number=lambda v: f"{round(v, 2) + 0.0:+.2f}",
        short=lambda v: f"{v:.3g}",
        percent=lambda v: f"{100 * v:.0f} %",
        loss=describe_loss,
    )
    page = templates.get_template(PAGE).render(
        found=found,
        rows=rows,
        best=None if found.best is None else rows[found.best - 1],
        quantities=quantities,
        sources=[] if prior is None else prior.provenance.get("beliefs", []),
        walks=base64.b64encode(png(draw_walks(found.runs))).decode(),
        intervals=base64.b64encode(png(draw_intervals(quantities))).decode(),
        seed=belief.provenance.get("seed"),
        version=__version__,
    )
    write_text(folder / PAGE, page)


def _run_row(folder: Path, number: int, run: AdaptationRun) -> RunRow:
    place = Path(run.log).parent
    interval = None
    if run.predicted is not None and run.deviation is not None:
        arm = _HALF_WIDTH * run.deviation
        interval = run.predicted - arm, run.predicted + arm

    def link(name: str) -> str | None:
        return (place / name).as_posix() if (folder / place / name).exists() else None

    schedule = ActuationSchedule.load(folder / run.schedule)
    return RunRow(number, run, schedule, interval, link(_FILM), link(_REPORT))


def quantity_rows(
    nominal: RobotParameters, prior: PrintedScene | None, belief: PrintedScene
) -> list[QuantityRow]:
    """The quantities of the robot with their 95 % intervals, before and after the films, without those that
    no film determines: an ensemble of 64 members becomes narrower in them by chance."""
    names, rows = belief.parameters, []
    unknown = np.eye(len(names))
    before = nominal if prior is None else prior.robot
    for name, quantity in QUANTITIES.items():
        gradient = quantity.gradient(names)
        if (
            name in _UNSEEN or not gradient.any() or quantity.value(nominal) == 0
        ):  # such as of sockets, of a robot with pins
            continue
        widths = [
            _HALF_WIDTH * float(np.sqrt(gradient @ covariance @ gradient))
            for covariance in (unknown if prior is None else prior.covariance, belief.covariance)
        ]
        values = quantity.value(before), quantity.value(belief.robot)
        intervals = [quantity.interval(*both) for both in zip(values, widths, strict=True)]
        rows.append(
            QuantityRow(
                name.replace("_", " "), quantity.unit, values[0], intervals[0], values[1], intervals[1],
                widths[1] / widths[0],
            )
        )  # fmt: skip
    return rows


def draw_walks(runs: Sequence[AdaptationRun]) -> Figure:
    """The filmed walk of each run, and the interval that was predicted before it."""
    figure, axes = new_axes(7.0, 3.2, xlabel="run", ylabel="body lengths per five cycles")
    lost = " or was lost" if any(run.lost_at_s is not None for run in runs) else ""
    for number, run in enumerate(runs, start=1):
        first = number == 1
        if run.predicted is not None and run.deviation is not None:
            axes.errorbar(
                number - 0.08, run.predicted, _HALF_WIDTH * run.deviation, fmt="s", color=_BEFORE, capsize=4,
                label="predicted before the run, 95 % interval" if first else None,
            )  # fmt: skip
        axes.plot(
            number + 0.08, run.filmed, "o" if run.upright else "x", color=_FILMED, ms=7,
            label=f"filmed (cross: it fell{lost})" if first else None,
        )  # fmt: skip
    axes.axhline(0.0, color="#cccccc", lw=0.8, zorder=0)
    axes.set_xticks(range(1, len(runs) + 1))
    axes.set_xlim(0.5, len(runs) + 0.5)
    axes.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def draw_intervals(rows: Sequence[QuantityRow]) -> Figure:
    """Each quantity with its interval before and after the films, over its value before. The transition
    temperature, whose ratio would tell nothing, is left out."""
    shown = [row for row in rows if row.name != "transition"]
    figure, axes = new_axes(7.0, 0.3 * len(shown) + 1.0, xlabel="value / value before the films")
    for place, row in enumerate(reversed(shown)):
        for shift, value, interval, colour, label in (
            (0.16, row.before, row.before_interval, _BEFORE, "before the films"),
            (-0.16, row.after, row.after_interval, _AFTER, "after"),
        ):
            ends = np.array(interval) / row.before
            axes.plot(ends, [place + shift] * 2, color=colour, lw=2.5, label=label if place == 0 else None)
            axes.plot(value / row.before, place + shift, "o", color=colour, ms=4)
    axes.axvline(1.0, color="#999999", lw=0.8, zorder=0)
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    ticks = [t for t in (0.1, 0.2, 0.5, 0.7, 1, 1.5, 2, 5, 10) if low <= t <= high]
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks], minor=False)
    axes.minorticks_off()
    axes.set_yticks(range(len(shown)), [row.name for row in reversed(shown)], fontsize=8)
    axes.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure
