"""Which runs are shown, and in which order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import date

from hardware.catalogue.columns import Column
from hardware.catalogue.runs import CataloguedRun

Key = Callable[[CataloguedRun], str | float | None]
COLUMNS: dict[Column, Key] = {
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


def selected(
    runs: Iterable[CataloguedRun], words: Sequence[str], since: date | None = None
) -> list[CataloguedRun]:
    """The runs that have every word in one of their texts, upper and lower case alike, and were recorded on
    that day or later. `#good` finds the tag."""
    wanted = [word.lower() for word in words]
    return [
        run
        for run in runs
        if (since is None or run.recorded >= since.isoformat()) and all(w in _text(run) for w in wanted)
    ]


def _text(run: CataloguedRun) -> str:
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
