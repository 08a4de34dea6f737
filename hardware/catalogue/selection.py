"""Which runs are shown, and in which order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import date

from hardware.catalogue.columns import Column
from hardware.catalogue.runs import CataloguedRun

Key = Callable[[CataloguedRun], str | float | None]
COLUMNS: dict[Column, Key] = {
    "recorded": lambda r: r.facts.recorded or None,
    "log": lambda r: str(r.log),
    "rig": lambda r: r.facts.rig or None,
    "design": lambda r: r.facts.design or None,
    "predicted": lambda r: r.predicted,
    "filmed": lambda r: r.filmed,
    "verdict": lambda r: r.verdict or None,
    "seconds": lambda r: r.facts.seconds,
    "ended": lambda r: r.facts.ended or None,
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
        if (since is None or run.facts.recorded >= since.isoformat()) and all(w in _text(run) for w in wanted)
    ]


def _text(run: CataloguedRun) -> str:
    f = run.facts
    own = (str(run.log), f.rig, f.physics, f.design, f.robot, f.ended, *f.faults, f.recovered, f.damage)
    tags = (f"#{tag}" for tag in run.notes.tags)
    notes = (note.text for note in run.notes.notes)
    return "\n".join((*own, run.verdict, "damaged" * bool(f.damage), *tags, *notes)).lower()


def ordered(runs: Iterable[CataloguedRun], column: Column, reverse: bool = False) -> list[CataloguedRun]:
    """The runs in the order of a column: dates and walks from the greatest, the rest from the least;
    `reverse` the other way. Those without a value come last in both."""
    key = COLUMNS[column]
    some = [(value, run) for run in runs if (value := key(run)) is not None]
    falling = column in ("recorded", "predicted", "filmed", "seconds")
    some.sort(key=lambda pair: pair[0], reverse=falling != reverse)
    return [run for _, run in some] + [run for run in runs if key(run) is None]
