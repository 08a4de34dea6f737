"""Runs as a table of plain text."""

from __future__ import annotations

from collections.abc import Sequence

from hardware.catalogue.runs import CataloguedRun

HEADER = ("log", "recorded", "rig", "robot", "gait", "predicted", "filmed", "verdict", "ended", "tags")
_PLAYED = "played to the end"


def cells(run: CataloguedRun) -> tuple[str, ...]:
    """What a row says of a run, in the order of `HEADER`."""
    f = run.facts
    if f.damage and not f.recorded:
        return (str(run.log), "", "", "", "", "", "", "", f"damaged: {f.damage}", _tags(run))
    gait = "" if f.period_s is None else f"{f.cycles} x {f.period_s:g} s"
    robot = " ".join(part for part in (f.design[:8], "" if f.robot == "intact" else f.robot) if part)
    date = f.recorded[:16].replace("T", " ")
    walks = signed(run.predicted), signed(run.filmed)
    return (str(run.log), date, f.rig, robot, gait, *walks, run.verdict, ending(run), _tags(run))


def ending(run: CataloguedRun) -> str:
    """How the run ended, and what is wrong with its log."""
    f = run.facts
    said = "to the end" if f.ended == _PLAYED else f.ended or "not said"
    # What the player said last is often the fault itself.
    others = [fault for fault in f.faults if not fault.endswith(f.ended) or not f.ended]
    parts = (said, *others, "recovered" * bool(f.recovered), f.damage and f"damaged: {f.damage}")
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
    return " ".join(f"#{tag}" for tag in run.notes.tags)


def signed(value: float | None) -> str:
    """A walk with its sign; empty where there is none."""
    return "" if value is None else f"{value:+.2f}"
