"""The catalogue and comparisons of runs as pages of one file each, which need no network."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from eldir.core.figure_folder import page_templates
from eldir.core.files import write_text
from eldir.core.pictures import png
from eldir.core.version import __version__
from eldir_app.catalogue.listing import cells, ending, signed
from eldir_app.catalogue.runs import CataloguedRun
from eldir_calibration.report.comparison import CYCLES

if TYPE_CHECKING:
    from eldir_app.catalogue.comparison import ComparedRun


def write_page(runs: Sequence[CataloguedRun], page: Path) -> None:
    """Write the runs as a table that the reader filters and sorts, with links to logs and reports."""
    rows = [
        {
            "cells": cells(run),
            "damaged": bool(run.damage),
            "verdict": run.verdict,
            "ended": ending(run),
            "log": _link(run.log, page),
            "report": _link(run.report.parent / "index.html", page) if run.report else "",
            "sentence": run.reported.sentence if run.reported else "",
            "notes": run.notes,
        }
        for run in runs
    ]
    catalogue = page_templates("eldir_app.catalogue").get_template("catalogue.html")
    write_text(page, catalogue.render(rows=rows, made=_made()))


def write_comparison(runs: Sequence[ComparedRun], page: Path) -> None:
    """Write the figures of `comparison.figures` and a table of what differs between the runs."""
    from eldir_app.catalogue.comparison import figures

    figures_ = [
        (caption, base64.b64encode(png(figure)).decode()) for caption, figure in figures(runs).items()
    ]
    rows = [
        ("robot", [one.run.kind[0] for one in runs]),
        ("rig", [f"{one.run.rig.name}{one.run.moved_by}" for one in runs]),
        ("gait", [f"{one.run.schedule.cycles} x {one.run.schedule.period_s:g} s" for one in runs]),
        ("cycles filmed", [str(one.motion.cycles) for one in runs]),
        ("predicted by the schedule", [signed(one.predicted) for one in runs]),
        ("filmed", [signed(one.motion.displacement()) for one in runs]),
        ("filmed, mm in a cycle", [f"{_millimetres(one):+.0f}" for one in runs]),
    ]
    text = page_templates("eldir_app.catalogue").get_template("comparison.html").render(
        names=[one.name for one in runs], rows=rows, figures=figures_, made=_made()
    )  # fmt: skip
    write_text(page, text)


def _millimetres(one: ComparedRun) -> float:
    return 1e3 * one.motion.displacement() * one.motion.body_length / CYCLES


def _link(path: Path, page: Path) -> str:
    """A path as seen from a page; empty if there is nothing."""
    if not path.exists():
        return ""
    return quote(os.path.relpath(path.absolute(), page.absolute().parent))


def _made() -> str:
    return f"eldir {__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
