"""Figures and tables of a run of printed robots, as a page, pictures and CSV files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from eldir.built.robot import build
from eldir.core.figure_folder import csv_text, page_templates, write_figures
from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir.evolution import tables
from eldir.evolution.printed import figures
from eldir.evolution.printed.archive import Walker
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.printed.status import status_of

_SHOWN = 12
"""Elites whose bodies and gaits are drawn, the best first."""


def write_printed_analysis(
    run: PrintedRun, folder: Path, step: Callable[[str, float], None] = lambda what, part: None
) -> list[figures.Elite]:
    """Write `index.html`, every figure as SVG and PNG, and every number as CSV into a new folder, whole
    or not at all. Returns the elites, best first. Raises `InputError` where there is none yet."""
    step("reading", 0.0)
    archive, status = run.restore().archive, status_of(run)
    elites = [_elite(run, walker) for walker in archive.ranked()]
    if not elites:
        raise InputError(
            f"{run.path} has no robot that walks yet",
            remedy=f"continue with eldir evolve --resume {run.path}",
        )
    tried = [_tried(run, generation) for generation in range(status.whole)]
    shown = elites[:_SHOWN]
    step("drawing", 0.3)
    drawn = {
        "progress": (
            "Robots that got to their first look, by generation (mean of 8 samples and its standard error), "
            "and the elites after all looks. The best of many first looks is too good: later ones lower it",
            figures.progress(tried, elites),
        ),
        "kinds": (
            "The best robot of each height and length: expected walk in body lengths per five cycles. In "
            "brackets: how many kinds there are, which differ in their number of masses",
            figures.kinds(elites),
        ),
        "elites": (
            "The best elites at one scale, with motors, expected walk and number",
            figures.bodies(shown),
        ),
        "gaits": ("When each motor of these elites is heated, one row a motor", figures.gaits(shown)),
        "walks": (
            "The walks of all samples of these elites; a sample that falls, folds or buckles counts as 0",
            figures.walks(shown),
        ),
    }
    page = page_templates("eldir.evolution").get_template("printed.html").render(
        run=run, status=status, elites=shown, figures={name: caption for name, (caption, _) in drawn.items()}
    )  # fmt: skip
    numbers = {"elites": _elites_table(elites), "generations": _generations_table(tried)}
    write_figures(folder, page, {name: figure for name, (_, figure) in drawn.items()}, numbers)
    return elites


def _elite(run: PrintedRun, walker: Walker) -> figures.Elite:
    body = walker.genome.body(run.config.lattice)
    gait = walker.genome.gait(body, run.config.timings)
    heating = run.config.timings[walker.genome.timing].heating
    return figures.Elite(walker, body, build(body, run.config.printed), gait.period, heating, gait.phase)


def _tried(run: PrintedRun, generation: int) -> figures.Tried:
    table = tables.read(run.generation_file(generation), ["screened", "walks"])
    looks = [w for w in tables.rows(table, "walks") if len(w) > 1]
    return figures.Tried(
        np.array(table["screened"].to_pylist(), np.float64),
        np.array([[w.mean(), w.std(ddof=1) / np.sqrt(len(w))] for w in looks]).reshape(-1, 2),
    )


def _elites_table(elites: list[figures.Elite]) -> str:
    def row(rank: int, e: figures.Elite) -> list[Any]:
        w = e.walker
        width, height = 1e3 * np.ptp(e.robot.positions, axis=0)
        walks = [w.expected, w.error, len(w.walks), w.worth, 1e3 * e.per_cycle, 1e3 * e.per_minute]
        body = [*w.niche, e.body.motors, width, height, e.height_over_base]
        phases = " ".join(f"{p:.3f}" for p in e.phase)
        return [rank, w.number, w.parent, w.generation, *walks, *body, e.period, e.heating, phases]

    return csv_text(
        [
            "rank", "id", "parent", "generation", "expected", "standard_error", "samples", "worth",
            "mm_per_cycle", "mm_per_minute", "rows", "pitches", "masses", "motors_at_the_ground", "motors",
            "width_mm", "height_mm", "height_over_base", "period_s", "heating_s", "phases",
        ],
        (row(i, e) for i, e in enumerate(elites, start=1)),
    )  # fmt: skip


def _generations_table(tried: list[figures.Tried]) -> str:
    def best(values: FloatArray) -> float | str:
        return float(values.max()) if len(values) else ""

    return csv_text(
        ["generation", "tried", "best_screened", "looked_at", "best_first_look"],
        (
            [g, len(t.screened), best(t.screened), len(t.first_looks), best(t.first_looks[:, 0])]
            for g, t in enumerate(tried)
        ),
    )
