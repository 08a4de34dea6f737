"""Figures and tables of a run of printed robots, as a page, pictures and CSV files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from eldir.built import ground
from eldir.built.gait import CYCLES
from eldir.built.robot import PrintedRobot, build, height_over_base
from eldir.core.pictures import (
    GROUND,
    MOTOR,
    PASSIVE,
    Plot,
    csv_text,
    draw_plots,
    hide_frame,
    page_templates,
    write_figures,
)
from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir.evolution import tables
from eldir.evolution.best_walks import BestWalk, draw_walks
from eldir.evolution.figures import chart, draw_springs, whole_numbers
from eldir.evolution.printed.best_walks import printed_walks
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.printed.walker import Walker
from eldir.evolution.status import read_status
from eldir.morphology import Morphology
from eldir.terrain import Terrain

_COLUMNS = 4  # of robots side by side
_BESIDE = 0.1  # of the longest robot: ground that is drawn on either side of each
_AHEAD = 10.0  # body lengths of a terrain before the robot that are drawn, at most
_WALK = "walk [body lengths per 5 cycles]"
_SHOWN = 12
"""Elites whose bodies and gaits are drawn, the best first."""


@dataclass(frozen=True)
class TriedRobots:
    """The robots of one generation, by their trials."""

    screened_walks: FloatArray
    """Best walk in the first trial [body lengths per five cycles], shape (n,)."""
    first_estimates: FloatArray
    """Mean and standard error of the first estimate of those that got there, shape (k, 2)."""


@dataclass(frozen=True)
class Elite:
    """An elite, with what its walk means on a table."""

    walker: Walker
    body: Morphology
    robot: PrintedRobot
    """As printed."""
    period: float
    """Period of its gait [s]."""
    heating: float
    """How long each motor is heated in a period [s]."""
    phase: FloatArray
    """Start of heating of each motor as a fraction of the period, shape (A,)."""

    @property
    def per_cycle(self) -> float:
        """Expected walk of one cycle [m]."""
        return self.walker.expected * self.robot.body_length / CYCLES

    @property
    def per_minute(self) -> float:
        """Expected walk of one minute [m]."""
        return self.per_cycle * 60.0 / self.period

    @property
    def height_over_base(self) -> float:
        """Height divided by the distance of the outermost feet."""
        return height_over_base(self.robot)


def progress_figure(tried: Sequence[TriedRobots], elites: Sequence[Elite]) -> Figure:
    """Figure of the first estimates by generation, the best of them so far, and the elites of today."""
    figure, axes = chart("generation", _WALK)
    means = [t.first_estimates for t in tried]
    born = np.repeat(np.arange(len(means)), [len(m) for m in means])
    estimates = np.concatenate(means)
    axes.errorbar(
        born,
        estimates[:, 0],
        estimates[:, 1],
        fmt="o",
        ms=2.5,
        lw=0.6,
        color=PASSIVE,
        alpha=0.6,
        label="first estimates",
    )
    best = np.fmax.accumulate([m[:, 0].max(initial=-np.inf) for m in means])
    known = np.isfinite(best)
    axes.step(
        np.flatnonzero(known),
        best[known],
        where="post",
        color=PASSIVE,
        lw=1.2,
        label="best first estimate so far",
    )
    axes.errorbar(
        [e.walker.generation for e in elites], [e.walker.expected for e in elites],
        [e.walker.error for e in elites], fmt="o", ms=4.5, lw=1.0, color=MOTOR,
        label="elites, all their samples",
    )  # fmt: skip
    axes.legend(frameon=False, fontsize="small")
    return figure


def archive_figure(elites: Sequence[Elite]) -> Figure:
    """Map of the archive: the best elite by rows of triangles and length, and how many sizes there are; one
    panel for each number of motors at the ground."""
    sizes = Counter((n.rows, n.length, n.grounded) for n in (e.walker.niche for e in elites))
    best: dict[tuple[int, int, int], float] = {}
    for n, expected in ((e.walker.niche, e.walker.expected) for e in elites):
        place = n.rows, n.length, n.grounded
        best[place] = max(expected, best.get(place, -np.inf))
    rows, lengths = (range(min(v), max(v) + 1) for v in list(zip(*best, strict=True))[:2])
    grounded = sorted({motors for *_, motors in best})
    size = (1.6 + len(grounded) * max(2.4, 0.6 * len(lengths)), 1.4 + 0.6 * max(len(rows), 3))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(1, len(grounded), squeeze=False, sharey=True).ravel()
    most, least = max(best.values()), min(0.0, *best.values())
    for axes, motors in zip(panels, grounded, strict=True):
        fitness = np.full((len(rows), len(lengths)), np.nan)
        for (row, length, own), expected in best.items():
            if own != motors:
                continue
            fitness[row - rows[0], length - lengths[0]] = expected
            dark = expected - least < 0.6 * (most - least)
            axes.text(
                length, row, f"{expected:.1f}\n({sizes[row, length, own]})", ha="center", va="center",
                fontsize="small", color="white" if dark else "black",
            )  # fmt: skip
        image = axes.imshow(
            fitness, origin="lower", cmap="viridis", vmin=least, vmax=most, aspect="auto",
            extent=(lengths[0] - 0.5, lengths[-1] + 0.5, rows[0] - 0.5, rows[-1] + 0.5),
        )  # fmt: skip
        axes.set_title(f"{motors} motor{'s' * (motors != 1)} at the ground", fontsize="small")
        axes.set_xlabel("length [pitches]")
        for axis in (axes.xaxis, axes.yaxis):
            whole_numbers(axis)
    panels[0].set_ylabel("rows of triangles")
    figure.colorbar(image, ax=list(panels), label=_WALK.replace(" [", "\n["))
    return figure


def bodies_figure(elites: Sequence[Elite], terrain: Terrain | None = None) -> Figure:
    """Picture of elites side by side at one scale, on a table or where they begin on the terrain."""
    rows = -(-len(elites) // _COLUMNS)
    figure = Figure(figsize=(3.0 * _COLUMNS, 2.4 * rows), layout="constrained")
    drawn = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True, sharey=True).ravel()
    for axes in drawn:
        axes.axis("off")
    longest = max(e.robot.body_length for e in elites)
    for axes, e in zip(drawn, elites, strict=False):
        begin, surface = ground.begin_on(e.robot, terrain, _BESIDE * longest)
        origin = np.array([(begin[:, 0].min() + begin[:, 0].max()) / 2, begin[:, 1].min()])
        draw_springs(axes, begin - origin, e.body)
        axes.plot(*(begin - origin).T, "o", ms=2.5, color="black")
        axes.plot(*(surface - origin).T, color=GROUND, lw=1.0, zorder=0)
        axes.set_aspect("equal")
        axes.set_title(
            f"{e.walker.number}: {e.walker.expected:+.2f} (standard error {e.walker.error:.2f})\n"
            f"{1e3 * e.per_minute:.0f} mm a minute",
            fontsize="small",
        )
    drawn[0].autoscale()
    return figure


def ground_figure(best: Elite, terrain: Terrain) -> Figure:
    """Figure of the terrain, with a robot where it begins."""
    figure = Figure(figsize=(8.0, 3.0), layout="constrained")
    axes = figure.add_subplot(xlabel="forward [m]", ylabel="height [m]")
    begin = ground.place(best.robot, terrain)[:2].T
    draw_springs(axes, begin, best.body)
    length, (back, front) = best.robot.body_length, (begin[:, 0].min(), begin[:, 0].max())
    first, last = back - length, min(max(terrain.x0[-1], front), front + _AHEAD * length) + length
    axes.plot(*terrain.outline(first, last).T, color=GROUND)
    axes.set_aspect("equal")
    axes.margins(0.02)
    hide_frame(axes)
    return figure


def gaits_figure(elites: Sequence[Elite]) -> Figure:
    """Figure of the heating of each motor over one period."""
    figure = Figure(figsize=(6.4, 0.8 + 0.42 * len(elites)), layout="constrained")
    axes = figure.add_subplot(xlabel="time in the period [s]", ylabel="robot")
    longest = max(e.period for e in elites)
    for row, e in enumerate(elites):
        height = 0.8 / len(e.phase)
        axes.barh(row, e.period, height=0.9, color="#f0f0f0")
        for motor, phase in enumerate(e.phase):
            at = row - 0.4 + (motor + 0.5) * height
            for begin in (phase * e.period, (phase - 1.0) * e.period):
                left, right = max(begin, 0.0), min(begin + e.heating, e.period)
                if right > left:
                    axes.barh(at, right - left, left=left, height=0.8 * height, color=MOTOR)
    axes.set_yticks(range(len(elites)), [str(e.walker.number) for e in elites])
    axes.set(xlim=(0.0, longest), ylim=(len(elites) - 0.5, -0.5))
    hide_frame(axes)
    return figure


def walks_figure(elites: Sequence[Elite]) -> Figure:
    """Figure of the walks of all samples, and the fitness of each elite."""
    figure, axes = chart("robot, best first", _WALK)
    for place, e in enumerate(elites):
        own = e.walker.walks
        beside = place + 0.28 * (np.arange(len(own)) / max(len(own) - 1, 1) - 0.5)
        axes.plot(beside, own, "o", ms=2.5, color=PASSIVE, alpha=0.8, label="" if place else "samples")
        across = [place - 0.3, place + 0.3]
        mean, fitness = ("", "") if place else ("mean", "mean less half a standard deviation")
        axes.plot(across, 2 * [e.walker.expected], color=MOTOR, lw=2, label=mean)
        axes.plot(across, 2 * [e.walker.fitness], color="black", lw=1, ls=":", label=fitness)
    axes.set_xticks(range(len(elites)), [str(e.walker.number) for e in elites])
    axes.legend(frameon=False, fontsize="small", loc="lower left")
    return figure


def write_printed_analysis(
    run: PrintedRun, folder: Path, step: Callable[[str, float], None] = lambda what, part: None
) -> list[Elite]:
    """Write `index.html`, every figure as SVG and PNG, and every number as CSV into a new folder, whole
    or not at all. Returns the elites, best first. Raises `InputError` where there is none yet."""
    step("reading", 0.0)
    status, elites = read_status(run), [_elite(run, walker) for walker in run.read_last_elites()]
    if not elites:
        raise InputError(
            f"{run.path} has no robot that walks yet",
            remedy=f"continue with eldir evolve --resume {run.path}",
        )
    tried = [_tried(run, generation) for generation in range(status.whole)]
    shown = elites[:_SHOWN]
    step("walking again", 0.4)
    walks = printed_walks(run, status.whole)
    step("drawing", 0.7)
    plots = _plots(run, tried, elites, walks)
    drawn, left_out = draw_plots(plots)
    page = page_templates("eldir.evolution").get_template("printed.html").render(
        run=run, status=status, elites=shown, left_out=left_out,
        figures={name: plots[name].caption for name in drawn},
    )  # fmt: skip
    numbers = {"elites": _elites_table(elites), "generations": _generations_table(tried)}
    write_figures(folder, page, drawn, numbers)
    return elites


def _plots(
    run: PrintedRun, tried: Sequence[TriedRobots], elites: list[Elite], walks: Sequence[BestWalk]
) -> dict[str, Plot]:
    """The figures of a run; those with nothing to draw say why."""
    shown, terrain = elites[:_SHOWN], run.config.terrain
    estimates = sum(len(t.first_estimates) for t in tried)
    places = {(n.rows, n.length, n.grounded) for n in (e.walker.niche for e in elites)}
    plots = {
        "progress": Plot(
            "Robots that reached the last trial, by generation (mean of 8 samples and its standard error), "
            "and the elites with all their samples. The best of many first estimates is too good: later "
            "ones lower it",
            partial(progress_figure, tried, elites),
            "" if estimates > 1 else "progress: only one robot reached the last trial",
        ),
        "best-walks": Plot(
            "The robot with the best first estimate so far, every ten generations, or three times in a short "
            "run. It walks as printed, for five cycles, and is drawn at the beginning (pale), half-way and "
            "at the end. The line is the path of the mean of its hubs",
            partial(draw_walks, walks, terrain),
            "" if walks else "walks of the best robots: none has a first estimate",
        ),
        "archive": Plot(
            "The best robot of each height and length: expected walk in body lengths per five cycles. In "
            "brackets: the number of niches, which differ in their number of masses",
            partial(archive_figure, elites),
            "" if len(places) > 1 else "the map of the archive: all elites have one height and one length",
        ),
        "elites": Plot(
            "The best elites at one scale, with motors, expected walk and number",
            partial(bodies_figure, shown, terrain),
        ),
        "gaits": Plot(
            "When each motor of these elites is heated, one row a motor", partial(gaits_figure, shown)
        ),
        "walks": Plot(
            "The walks of all samples of these elites; a sample that falls, folds or buckles counts as 0",
            partial(walks_figure, shown),
        ),
    }
    if terrain is not None:
        plots["ground"] = Plot(
            "The ground on which all robots were tried, and the best one where it begins",
            partial(ground_figure, elites[0], terrain),
        )
    return plots


def _elite(run: PrintedRun, walker: Walker) -> Elite:
    body = walker.genome.body(run.config.lattice)
    gait = walker.genome.gait(body, run.config.timings)
    heating = run.config.timings[walker.genome.timing].heating
    return Elite(walker, body, build(body, run.config.printed), gait.period, heating, gait.phase)


def _tried(run: PrintedRun, generation: int) -> TriedRobots:
    table = tables.read(run.generation_file(generation), ["screened", "walks"])
    looks = [w for w in tables.rows(table, "walks") if len(w) > 1]
    return TriedRobots(
        np.array(table["screened"].to_pylist(), np.float64),
        np.array([[w.mean(), w.std(ddof=1) / np.sqrt(len(w))] for w in looks]).reshape(-1, 2),
    )


def _elites_table(elites: list[Elite]) -> str:
    def row(rank: int, e: Elite) -> list[Any]:
        w = e.walker
        width, height = 1e3 * np.ptp(e.robot.positions, axis=0)
        walks = [w.expected, w.error, len(w.walks), w.fitness, 1e3 * e.per_cycle, 1e3 * e.per_minute]
        body = [*w.niche, e.body.motors, width, height, e.height_over_base]
        phases = " ".join(f"{p:.3f}" for p in e.phase)
        return [rank, w.number, w.parent, w.generation, *walks, *body, e.period, e.heating, phases]

    return csv_text(
        [
            "rank", "id", "parent", "generation", "expected", "standard_error", "samples", "fitness",
            "mm_per_cycle", "mm_per_minute", "rows", "pitches", "masses", "motors_at_the_ground", "motors",
            "width_mm", "height_mm", "height_over_base", "period_s", "heating_s", "phases",
        ],
        (row(i, e) for i, e in enumerate(elites, start=1)),
    )  # fmt: skip


def _generations_table(tried: list[TriedRobots]) -> str:
    def best(values: FloatArray) -> float | str:
        return float(values.max()) if len(values) else ""

    return csv_text(
        ["generation", "tried", "best_screened", "evaluated", "best_first_estimate"],
        (
            [
                g,
                len(t.screened_walks),
                best(t.screened_walks),
                len(t.first_estimates),
                best(t.first_estimates[:, 0]),
            ]
            for g, t in enumerate(tried)
        ),
    )
