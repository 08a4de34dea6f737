"""Which runs are listed, in which order, as a table of plain text or as an HTML page."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, date, datetime
from pathlib import Path
from urllib.parse import quote

from eldir.core.files import write_text
from eldir.core.pictures import page_templates
from eldir.core.version import __version__
from eldir_app.catalogue import Column
from eldir_app.catalogue.runs import CataloguedRun
from eldir_hardware.log.messages import PLAYED_TO_END

HEADER = ("log", "recorded", "rig", "robot", "gait", "predicted", "filmed", "verdict", "ended", "tags")
_Key = Callable[[CataloguedRun], str | float | None]
COLUMNS: dict[Column, _Key] = {
    "recorded": lambda r: r.recorded or None,
    "log": lambda r: str(r.log),
    "rig": lambda r: r.rig or None,
    "design": lambda r: r.design or None,
    "predicted": lambda r: r.expected,
    "filmed": lambda r: r.filmed,
    "verdict": lambda r: r.verdict or None,
    "seconds": lambda r: r.seconds,
    "ended": lambda r: r.ended or None,
}
"""Columns to sort by."""


def cells(run: CataloguedRun) -> tuple[str, ...]:
    """The texts of a row, in the order of `HEADER`."""
    if run.damage and not run.recorded:
        return (str(run.log), "", "", "", "", "", "", "", f"damaged: {run.damage}", _tags(run))
    gait = "" if run.period_s is None else f"{run.cycles} x {run.period_s:g} s"
    robot = " ".join(part for part in (run.design[:8], "" if run.robot == "intact" else run.robot) if part)
    date = run.recorded[:16].replace("T", " ")
    walks = signed(run.expected), signed(run.filmed)
    return (str(run.log), date, run.rig, robot, gait, *walks, run.verdict, ending(run), _tags(run))


def ending(run: CataloguedRun) -> str:
    """How the run ended, and what is damaged in its log."""
    last = "to the end" if run.ended == PLAYED_TO_END else run.ended or "unknown"
    # The last status of the player is often the fault itself.
    others = [fault for fault in run.faults if not fault.endswith(run.ended) or not run.ended]
    last = f"rehearsal: {last}" if run.rehearsal else last
    parts = (last, *others, "recovered" * bool(run.recovered), run.damage and f"damaged: {run.damage}")
    return "; ".join(part for part in parts if part)


def table(runs: Sequence[CataloguedRun]) -> list[str]:
    """Lines of aligned columns; the longest column, how the run ended, is shortened."""
    rows = [HEADER, *(cells(run) for run in runs)]
    rows = [tuple(_shorten(cell, 72) if k == 8 else cell for k, cell in enumerate(row)) for row in rows]
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEADER))]
    shown = [k for k in range(len(HEADER)) if any(row[k] for row in rows[1:])] if runs else []
    return ["  ".join(row[k].ljust(widths[k]) for k in shown).rstrip() for row in rows if shown]


def _shorten(text: str, max_length: int) -> str:
    return text if len(text) <= max_length else text[: max_length - 3] + "..."


def _tags(run: CataloguedRun) -> str:
    return " ".join(f"#{tag}" for tag in run.tags)


def signed(value: float | None) -> str:
    """A walk with its sign; empty where there is none."""
    return "" if value is None else f"{value:+.2f}"


def selected(
    runs: Iterable[CataloguedRun], words: Sequence[str], since: date | None = None
) -> list[CataloguedRun]:
    """The runs whose texts contain every word, in upper or lower case, and that were recorded on that day or
    later. `#good` finds the tag."""
    lower = [word.lower() for word in words]
    return [
        run
        for run in runs
        if (since is None or run.recorded >= since.isoformat())
        and all(w in _searchable_text(run) for w in lower)
    ]


def _searchable_text(run: CataloguedRun) -> str:
    own = (str(run.log), run.rig, run.physics, run.design, run.robot, ending(run), run.recovered, run.damage)
    tags = (f"#{tag}" for tag in run.tags)
    notes = (note.text for note in run.notes)
    return "\n".join((*own, *run.faults, run.verdict, "damaged" * bool(run.damage), *tags, *notes)).lower()


def ordered(runs: Iterable[CataloguedRun], column: Column, reverse: bool = False) -> list[CataloguedRun]:
    """The runs sorted by a column: dates, walks and times in descending order, the rest in ascending order;
    `reverse` the other way round. Runs without a value come last in both cases."""
    key = COLUMNS[column]
    with_value = [(value, run) for run in runs if (value := key(run)) is not None]
    is_descending = column in ("recorded", "predicted", "filmed", "seconds")
    with_value.sort(key=lambda pair: pair[0], reverse=is_descending != reverse)
    return [run for _, run in with_value] + [run for run in runs if key(run) is None]


def write_page(runs: Sequence[CataloguedRun], page: Path) -> None:
    """Write the runs as one HTML file with a table to filter and sort, and links to logs and reports."""
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
    template = page_templates("eldir_app.catalogue").get_template("catalogue.html")
    write_text(page, template.render(rows=rows, made=version_and_date()))


def _link(path: Path, page: Path) -> str:
    """The relative link from a page to a file; empty if the file does not exist."""
    if not path.exists():
        return ""
    return quote(os.path.relpath(path.absolute(), page.absolute().parent))


def version_and_date() -> str:
    """The version of eldir and the time, for the foot of a page."""
    return f"eldir {__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
