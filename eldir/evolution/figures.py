"""The paper's figures of a run; every function returns one figure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from eldir.core.pictures import GROUND, MOTOR, PASSIVE, hide_frame, new_axes
from eldir.core.records import FloatArray
from eldir.evolution.paper.history import EvaluatedRobots, RunHistory, Trend
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.terrain import Terrain

_COLUMNS = 4  # of robots side by side
_ANCESTORS = 8  # whose bodies are shown
_CROWD = 1000  # robots from which on their dots are small and faint
_LEARNED, _INITIAL = "#14662a", "#7fcf8f"


def best(trend: Trend) -> Figure:
    """Figure of the initial and learned fitness of the fittest robot (paper, Fig. Increasingly differentiable
    robots)."""
    figure, axes = chart("generation", "displacement of the best [m]")
    axes.plot(trend.best, color=_LEARNED, label="learned")
    axes.plot(trend.best_initial, color=_INITIAL, label="initial")
    _legend(axes)
    return figure


def population(trend: Trend) -> Figure:
    """Figure of the mean and standard deviation of the population (paper, Fig. Mean fitness across the
    population)."""
    figure, axes = chart("generation", "displacement of the population [m]")
    generations = np.arange(len(trend.mean))
    for name, mean, sd, colour in (
        ("learned", trend.mean, trend.sd, _LEARNED),
        ("initial", trend.mean_initial, trend.sd_initial, _INITIAL),
    ):
        axes.plot(generations, mean, color=colour, label=f"{name}, mean ± SD")
        axes.fill_between(generations, mean - sd, mean + sd, color=colour, alpha=0.25, lw=0)
    _legend(axes)
    return figure


def bodies(trend: Trend) -> Figure:
    """Figure of the mean size and share of motors of the population."""
    figure, axes = chart("generation", "springs")
    axes.plot(trend.size, color="#404040", label="springs (left)")
    axes.set_ylim(bottom=0)
    share = axes.twinx()
    share.plot(trend.active, color=_LEARNED, label="share of motors (right)")
    share.set(ylim=(0, 1))
    handles = [*axes.get_lines(), *share.get_lines()]
    # Above: the two lines may be anywhere.
    axes.legend(handles=handles, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure


def discarded(trend: Trend) -> Figure:
    """Figure of the unstable robots in every generation."""
    figure, axes = chart("generation", "discarded [% of the robots evaluated]")
    axes.bar(np.arange(len(trend.evaluated)), 100 * trend.discarded / trend.evaluated, color="#b02a1e")
    return figure


def size_and_fitness(robots: EvaluatedRobots, rho: float) -> Figure:
    """Figure of all random progenitors (paper, Fig. The relationship between size and fitness)."""
    figure, axes = chart("springs", "learned displacement [m]")
    crowded = min(1.0, len(robots.sizes) / _CROWD)
    axes.scatter(
        robots.sizes,
        robots.fitness,
        s=40 - 36 * crowded,
        color=_LEARNED,
        alpha=0.9 - 0.5 * crowded,
        lw=0,
        rasterized=True,
    )
    axes.set_title(f"Spearman's ρ = {rho:.3f}, {len(robots.sizes)} robots", fontsize="medium")
    return figure


def gallery(lattice: Lattice, robots: EvaluatedRobots, titles: Sequence[str]) -> Figure:
    """Picture of robots side by side at one scale, in the colours of every picture of a robot."""
    rows = -(-len(robots.ids) // _COLUMNS)
    figure = Figure(figsize=(3.0 * _COLUMNS, 2.2 * rows), layout="constrained")
    drawn = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True, sharey=True).ravel()
    for axes in drawn:
        axes.axis("off")
    for i, title in enumerate(titles):
        _robot(drawn[i], lattice, robots, i)
        drawn[i].set_title(title, fontsize="small")
    return figure


def learning(paths: Sequence[tuple[str, FloatArray]], terrain: Terrain) -> Figure:
    """Figure of the centres of mass over all iterations, light to dark (paper, Fig. Learning to walk)."""
    figure = Figure(figsize=(7.0, 2.6 * len(paths)), layout="constrained")
    drawn = figure.subplots(len(paths), 1, squeeze=False, sharex=True).ravel()
    for axes, (title, path) in zip(drawn, paths, strict=True):
        shades = colormaps["Greens"](np.linspace(0.25, 1.0, len(path)))
        axes.add_collection(LineCollection(list(path), colors=list(shades), linewidths=0.8))
        axes.autoscale()
        left, right = axes.get_xlim()
        x = np.linspace(left, right, 400)
        if not terrain.is_flat:
            axes.plot(x, terrain.height(x), color=GROUND)
        axes.set_title(title, fontsize="small", loc="left")
        axes.set_ylabel("height [m]")
    drawn[-1].set_xlabel("centre of mass [m]")
    return figure


def lineage(history: RunHistory) -> Figure:
    """Figure of the best robot's ancestors: displacement, and some of their bodies."""
    line = history.line[::-1]
    figure = Figure(figsize=(2.0 * _ANCESTORS, 5.5), layout="constrained")
    grid = figure.add_gridspec(2, _ANCESTORS, height_ratios=(3, 2))
    axes = figure.add_subplot(grid[0, :])
    born = [int(p.ids[0]) // history.run.config.population for p in line]
    axes.plot(born, [p.fitness[0] for p in line], "o-", color=_LEARNED, label="learned")
    axes.plot(born, [p.initial[0] for p in line], "o-", color=_INITIAL, label="initial")
    axes.set(xlabel="born in generation", ylabel="displacement [m]")
    whole_numbers(axes.xaxis)
    hide_frame(axes)
    _legend(axes)
    chosen = np.unique(np.linspace(0, len(line) - 1, min(_ANCESTORS, len(line))).round().astype(int))
    first = None
    for column, i in enumerate(chosen):
        first = figure.add_subplot(grid[1, column], sharex=first, sharey=first)
        first.axis("off")
        _robot(first, history.run.config.lattice, line[i], 0)
        first.set_title(f"generation {born[i]}: {line[i].fitness[0]:.2f} m", fontsize="small")
    return figure


def chart(x: str, y: str) -> tuple[Figure, Axes]:
    """An empty figure with one pair of axes; whole numbers along x."""
    figure, axes = new_axes(6.4, 4.0, xlabel=x, ylabel=y)
    whole_numbers(axes.xaxis)
    return figure, axes


def whole_numbers(axis: Axis) -> None:
    """Ticks at whole numbers only, also where there is but one."""
    axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def _legend(axes: Axes) -> None:
    axes.legend(frameon=False)


def draw_springs(
    axes: Axes,
    positions: FloatArray,
    body: Morphology,
    widths: tuple[float, float] = (1.0, 2.6),
    alpha: float = 1.0,
) -> None:
    """Add the springs of a body whose masses are at these positions, shape (M, 2). `widths` of the lines:
    passive ones, motors; `alpha`: how opaque they are."""
    ends = positions[body.springs]
    for kind, colour, width in zip((~body.active, body.active), (PASSIVE, MOTOR), widths, strict=True):
        axes.add_collection(LineCollection(list(ends[kind]), colors=colour, linewidths=width, alpha=alpha))


def _robot(axes: Axes, lattice: Lattice, robots: EvaluatedRobots, i: int) -> None:
    body = develop(lattice, robots.genotype(i))
    filled = lattice.triangles[robots.triangles[i].ravel()]
    place = np.zeros((len(lattice.vertices), 2))
    place[body.vertices] = body.positions
    axes.add_collection(PolyCollection(list(place[filled]), facecolors="#f0f0f0"))
    draw_springs(axes, body.positions, body, (0.8, 1.6))
    axes.set_aspect("equal")
    axes.autoscale()
