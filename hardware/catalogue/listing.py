"""Runs as a table of plain text."""

from __future__ import annotations

from collections.abc import Sequence

from hardware.catalogue.runs import CataloguedRun

HEADER = ("log", "recorded", "rig", "robot", "gait", "predicted", "filmed", "verdict", "ended", "tags")
_PLAYED = "played to the end"


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
