"""Which runs are listed, in which order, and the table of plain text."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import date

from eldir_app.catalogue.columns import Column
from eldir_app.catalogue.runs import CataloguedRun

HEADER = ("log", "recorded", "rig", "robot", "gait", "predicted", "filmed", "verdict", "ended", "tags")
_PLAYED = "played to the end"
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
    """What a row says of a run, in the order of `HEADER`."""
    if run.damage and not run.recorded:
        return (str(run.log), "", "", "", "", "", "", "", f"damaged: {run.damage}", _tags(run))
    gait = "" if run.period_s is None else f"{run.cycles} x {run.period_s:g} s"
    robot = " ".join(part for part in (run.design[:8], "" if run.robot == "intact" else run.robot) if part)
    date = run.recorded[:16].replace("T", " ")
    walks = signed(run.expected), signed(run.filmed)
    return (str(run.log), date, run.rig, robot, gait, *walks, run.verdict, ending(run), _tags(run))


def ending(run: CataloguedRun) -> str:
    """How the run ended, and what is wrong with its log."""
    said = "to the end" if run.ended == _PLAYED else run.ended or "not said"
    # What the player said last is often the fault itself.
    others = [fault for fault in run.faults if not fault.endswith(run.ended) or not run.ended]
    parts = (said, *others, "recovered" * bool(run.recovered), run.damage and f"damaged: {run.damage}")
    return "; ".join(part for part in parts if part)


def table(runs: Sequence[CataloguedRun]) -> list[str]:
    """Lines of aligned columns; the longest, how the run ended, comes before the tags and is cut."""
    rows = [HEADER, *(cells(run) for run in runs)]
    rows = [tuple(_short(cell, 72) if k == 8 else cell for k, cell in enumerate(row)) for row in rows]
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEADER))]
    shown = [k for k in range(len(HEADER)) if any(row[k] for row in rows[1:])] if runs else []
    return ["  ".join(row[k].ljust(widths[k]) for k in shown).rstrip() for row in rows if shown]


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."


def _tags(run: CataloguedRun) -> str:
    return " ".join(f"#{tag}" for tag in run.tags)


def signed(value: float | None) -> str:
    """A walk with its sign; empty where there is none."""
    return "" if value is None else f"{value:+.2f}"


def selected(
    runs: Iterable[CataloguedRun], words: Sequence[str], since: date | None = None
) -> list[CataloguedRun]:
    """The runs that have every word in one of their texts, upper and lower case alike, and were recorded on
    that day or later. `#good` finds the tag."""
    wanted = [word.lower() for word in words]
    return [
        run
        for run in runs
        if (since is None or run.recorded >= since.isoformat())
        and all(w in _searched_text(run) for w in wanted)
    ]


def _searched_text(run: CataloguedRun) -> str:
    own = (str(run.log), run.rig, run.physics, run.design, run.robot, run.ended, run.recovered, run.damage)
    tags = (f"#{tag}" for tag in run.tags)
    notes = (note.text for note in run.notes)
    return "\n".join((*own, *run.faults, run.verdict, "damaged" * bool(run.damage), *tags, *notes)).lower()


def ordered(runs: Iterable[CataloguedRun], column: Column, reverse: bool = False) -> list[CataloguedRun]:
    """The runs in the order of a column: dates and walks from the greatest, the rest from the least;
    `reverse` the other way. Those without a value come last in both."""
    key = COLUMNS[column]
    some = [(value, run) for run in runs if (value := key(run)) is not None]
    falling = column in ("recorded", "predicted", "filmed", "seconds")
    some.sort(key=lambda pair: pair[0], reverse=falling != reverse)
    return [run for _, run in some] + [run for run in runs if key(run) is None]
