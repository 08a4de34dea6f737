"""The paper's figures and tables of a run, as a page, pictures and CSV files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eldir.core.files import require_new
from eldir.core.pictures import Plot, csv_text, draw_plots, page_templates, write_figures
from eldir.core.records import FloatArray
from eldir.evolution import figures
from eldir.evolution.best_walks import draw_walks, trained_walks
from eldir.evolution.paper.encoding import make_encoding
from eldir.evolution.paper.history import EvaluatedRobots, RunHistory, Trend, read_history
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.paper.status import describe_flags
from eldir.learning import learning_paths
from eldir.morphology import develop

_ZOO = 12
_EVERY = 10  # steps between two points of a drawn path
PAPER = {
    "size": {
        "All": ("176.15 (± 67.79 SD)", "63.28 (± 13.85 SD)"),
        "Best": ("80.0 (± 10.61 SD)", "55.0 (± 10.65 SD)"),
        "Largest": ("362.75 (± 2.05 SD)", "84.0 (± 16.14 SD)"),
    },
    "active": {
        "All": ("0.49 (± 0.04 SD)", "0.72 (± 0.03 SD)"),
        "Best": ("0.56 (± 0.03 SD)", "0.76 (± 0.03 SD)"),
        "Largest": ("0.50 (± 0.03 SD)", "0.67 (± 0.03 SD)"),
    },
}
"""Tables of the paper: generations 1 and 1000 of 10 000 robots, flat ground; SD over robots, for the best
and the largest over runs."""


def write_analysis(
    run: RunFolder, folder: Path, step: Callable[[str, float], None] = lambda what, part: None
) -> RunHistory:
    """Write `index.html`, every figure as SVG and PNG, and every number as CSV into a new folder, whole
    or not at all. Raises `EldirError` if the folder exists already."""
    from scipy.stats import spearmanr  # a second, and few commands need it

    require_new(folder)
    generations = run.config.generations + 1
    history = read_history(run, lambda done: step("reading", 0.5 * done / generations))
    rho, p = (float(v) for v in spearmanr(history.progenitors.sizes, history.progenitors.fitness))
    paths = []
    config = run.config
    by_the_seed = not make_encoding(config).has_initial_weights
    again = by_the_seed and not (config.inherit or config.randomisation)
    chosen = [("last generation", history.last), ("first generation", history.first)]
    for i, (name, robots) in enumerate(chosen if again else []):
        step("training the best again", 0.5 + 0.1 * i)
        paths.append((f"best of the {name}: {robots.fitness[0]:.3f} m", _best_path(run, robots)))
    zoo = _choose_diverse(history.last)
    step("training the best of every ten generations again" if again else "drawing", 0.7)
    plots = _plots(history, zoo, rho, p, paths)
    drawn, left_out = draw_plots(plots)
    tables = {name: _paper_table(history, name) for name in PAPER}
    total = (int(history.trend.evaluated.sum()), int(history.trend.discarded.sum()))
    page = page_templates("eldir.evolution").get_template("analysis.html").render(
        run=run, history=history, tables=tables, paper=PAPER, total=total,
        flagged=describe_flags(history.trend.chaotic[-1], history.trend.rounded[-1]),
        figures={name: plots[name].caption for name in drawn}, left_out=left_out,
    )  # fmt: skip
    numbers = _csv_tables(history, zoo, paths, tables, (rho, p))
    write_figures(folder, page, drawn, numbers)
    return history


def _plots(
    history: RunHistory, zoo: EvaluatedRobots, rho: float, p: float, paths: Sequence[tuple[str, FloatArray]]
) -> dict[str, Plot]:
    """The figures of a run; those with nothing to draw say why."""
    trend, config = history.trend, history.run.config
    single = "" if len(trend.best) > 1 else "values over the generations: only one is complete"
    lonely = "" if len(history.progenitors.ids) > 1 else "size and fitness of the progenitors: one was valid"
    unknown = (
        ""
        if paths
        else (
            "walks of the best robots and how they learned: with inherited weights, painted phases or "
            "sampled physics a robot cannot be trained again from its seed"
        )
    )
    rootless = "" if len(history.line) > 1 else "ancestors of the best robot: it is a random progenitor"
    sound = "" if trend.discarded.any() else "discarded robots: none was unstable"
    ground = config.scene.terrain
    titles = [f"{f:.2f} m" for f in zoo.fitness]
    return {
        "best": Plot(
            "Displacement of the best robot before and after learning", partial(figures.best, trend), single
        ),
        "population": Plot("Displacement of the population", partial(figures.population, trend), single),
        "size-and-fitness": Plot(
            f"Size and fitness of the random progenitors; Spearman's ρ = {rho:.3f} (p = {p:.2g}); "
            "the paper's 70 000: -0.08",
            partial(figures.size_and_fitness, history.progenitors, rho),
            lonely,
        ),
        "bodies": Plot(
            "Mean size and share of motors of the population", partial(figures.bodies, trend), single
        ),
        "zoo": Plot(
            "Designs of the last population that differ most in body, with their displacement",
            partial(figures.gallery, config.lattice, zoo, titles),
        ),
        "best-walks": Plot(
            "The best robot every ten generations, or three times in a short run. It was trained again "
            "with its seed, and is drawn at the beginning (pale), half-way and at the end of its walk. The "
            "line is the path of the mean of its masses",
            lambda: draw_walks(trained_walks(history), ground),
            unknown,
        ),
        "learning": Plot(
            "Centre of mass in the rollout of every learning iteration, light to dark",
            partial(figures.learning, paths, ground),
            unknown,
        ),
        "lineage": Plot("Ancestors of the best robot", partial(figures.lineage, history), rootless),
        "discarded": Plot("Robots discarded as unstable", partial(figures.discarded, trend), sound),
    }


def _best_path(run: RunFolder, robots: EvaluatedRobots) -> FloatArray:
    """The path of the best of some robots, which is trained again."""
    body = develop(run.config.lattice, robots.genotype(0))
    return learning_paths(
        body, run.config.scene, run.config.iterations, [int(robots.seeds[0])], _EVERY, run.config.training
    )


def _choose_diverse(robots: EvaluatedRobots) -> EvaluatedRobots:
    """The best robot; then, one after the other, the robot of the better half whose body differs most from
    those chosen."""
    masks = robots.triangles.reshape(len(robots.ids), -1)[: max(1, (len(robots.ids) + 1) // 2)]
    chosen = [0]
    while len(chosen) < min(_ZOO, len(masks)):
        unlike = (masks[:, None] != masks[None, chosen]).sum(axis=-1).min(axis=1)
        if not unlike.max():
            break
        chosen.append(int(unlike.argmax()))
    return robots.take(np.array(sorted(chosen)))


def _paper_table(history: RunHistory, kind: str) -> dict[str, tuple[str, str]]:
    """A table of the paper for this run: all, best and largest; first and last generation."""

    def column(robots: EvaluatedRobots, all_of: EvaluatedRobots) -> list[str]:
        largest = robots.sizes == robots.sizes.max()
        text = {"size": "{:.0f}", "active": "{:.2f}"}[kind]
        values, everyone = (np.asarray({"size": p.sizes, "active": p.active}[kind]) for p in (robots, all_of))
        spread = f"{everyone.mean():.2f} (± {everyone.std():.2f} SD)"
        return [spread, text.format(values[0]), text.format(values[largest].mean())]

    first = column(history.first, history.progenitors)
    last = column(history.last, history.last)
    return dict(zip(("All", "Best", "Largest"), zip(first, last, strict=True), strict=True))


def _csv_tables(
    history: RunHistory,
    zoo: EvaluatedRobots,
    paths: Sequence[tuple[str, FloatArray]],
    tables: dict[str, dict[str, tuple[str, str]]],
    correlation: tuple[float, float],
) -> dict[str, str]:
    trend = history.trend
    names = [f.name for f in fields(Trend)]
    population = history.run.config.population
    line = [(int(p.ids[0]) // population, p) for p in history.line]
    return {
        "generations": csv_text(
            ["generation", *names],
            ([g, *row] for g, row in enumerate(zip(*(getattr(trend, n) for n in names), strict=True))),
        ),
        "progenitors": csv_text(
            ["id", "springs", "active", "initial_m", "fitness_m"], _csv_rows(history.progenitors)
        ),
        "zoo": csv_text(["id", "springs", "active", "initial_m", "fitness_m"], _csv_rows(zoo)),
        "lineage": csv_text(
            ["generation", "id", "parent_1", "parent_2", "springs", "active", "initial_m", "fitness_m"],
            (
                [g, p.ids[0], *p.parents[0], p.sizes[0], p.active[0], p.initial[0], p.fitness[0]]
                for g, p in line
            ),
        ),
        "learning": csv_text(
            ["robot", "iteration", "point", "x_m", "y_m"],
            (
                [title.split(":")[0], i, k, *xy]
                for title, path in paths
                for i, iteration in enumerate(path)
                for k, xy in enumerate(iteration)
            ),
        ),
        "tables": csv_text(
            ["table", "robots", "first_generation", "last_generation"],
            ([name, who, *values] for name, rows in tables.items() for who, values in rows.items()),
        ),
        "correlation": csv_text(["spearman_rho", "p"], [correlation]),
    }


def _csv_rows(robots: EvaluatedRobots) -> Iterable[list[Any]]:
    return (
        list(row)
        for row in zip(robots.ids, robots.sizes, robots.active, robots.initial, robots.fitness, strict=True)
    )
