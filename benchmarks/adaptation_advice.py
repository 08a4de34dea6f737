"""What a robot walks that is given the supply which `eldir adapt` advises (decision 79).

Some runs with the template's current, which nobody measured. Then, if the springs got too hot, as many more
in the same folder with the lower current that is named; or, if a measured current is advised, the rig with
that current, in a new folder with the old one as its prior. What the last schedule walks there is compared
with the best of the gaits that the same rig allows (`benchmarks.headroom`), both in MuJoCo.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.headroom import Search
from benchmarks.hidden_robot import Rows
from eldir.built.gait import Gait
from eldir.built.samples import RISK
from eldir.errors import InputError
from eldir_calibration.adaptation.loop import adapt
from eldir_calibration.adaptation.runs import Adaptation, AdaptationConfig, SupplyAdvice
from eldir_hardware.planning.compiler import extract_gait
from eldir_hardware.rig.sections import MEASURED_CURRENT
from eldir_hardware.rig.template import CURRENT_LIMIT_A
from eldir_hardware.schedule import ActuationSchedule

CYCLES = 3
"""Counted cycles of a filmed run, and of a walk in MuJoCo."""


def follow_advice(designs: Sequence[Path], seeds: Sequence[int], runs: int, out: Path) -> None:
    """Print a table; the rows are kept in advice.jsonl."""
    rows = Rows(out / "advice.jsonl")
    print("| design | rig | runs | advice | runs then | true walk of the last | best of all gaits there |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for seed, design_file in product(seeds, designs):
        row = rows.find(design_file, seed)
        if row is None:
            row = _row(design_file, seed, runs, out / f"{design_file.stem}-{seed}")
            rows.add(row)
        print(_describe(row), flush=True)


def _row(design_file: Path, seed: int, runs: int, folder: Path) -> dict[str, Any]:
    begin, config = time.process_time(), AdaptationConfig(runs=runs, cycles=CYCLES)
    place = Search(design_file, seed, folder / "template")
    row: dict[str, Any] = {"design": str(design_file), "seed": seed, "then": None, "refused": ""}
    try:
        found = adapt(design_file, place.rig, place.folder / "adapted", place.drive, config)
    except InputError as error:
        return row | {"refused": str(error), "processor_s": time.process_time() - begin}
    row |= {"first": found.to_json(), "current_a": CURRENT_LIMIT_A}
    last = found
    if found.faults and (lower := found.faults[-1].lower_current_a):
        place, more = Search(design_file, seed, place.folder, lower, False), len(found.runs) + runs
        last = adapt(
            design_file, place.rig, place.folder / "adapted", place.drive, replace(config, runs=more)
        )
        row |= {"then": last.to_json(), "current_a": lower}
    elif advised := choose_advice(found.advice):
        prior, current = place.folder / "adapted", advised.current_limit_a
        place = Search(design_file, seed, folder / "advised", current)
        last = adapt(design_file, place.rig, place.folder / "adapted", place.drive, config, prior=[prior])
        row |= {"then": last.to_json(), "current_a": current}
    row["last"] = _true_walk(place, last)
    row["processor_s"] = time.process_time() - begin
    tried = place.row()
    return row | {"headroom": tried, "best": max(row["last"], tried["best"])}


def choose_advice(advice: Sequence[SupplyAdvice]) -> SupplyAdvice | None:
    """The advice with a measured current that predicts the longest walk, of those that are likely to bring
    it; None without."""
    promised = [
        (one.predicted - RISK * one.deviation, one)
        for one in advice
        if one.current <= MEASURED_CURRENT and one.predicted is not None and one.deviation is not None
    ]
    return max(promised, key=lambda pair: pair[0], default=(0.0, None))[1]


def _true_walk(place: Search, adaptation: Adaptation) -> float:
    """Of the best filmed run, or the last one; 0 where the robot falls."""
    number = adaptation.best or len(adaptation.runs)
    file = place.folder / "adapted" / adaptation.runs[number - 1].schedule
    gait = extract_gait(ActuationSchedule.load(file))
    assert isinstance(gait, Gait)
    walk = place.robot.walk(gait, CYCLES)
    return walk if math.isfinite(walk) else 0.0


def _describe(row: dict[str, Any]) -> str:
    """The row of a rig in the table."""
    if row["refused"]:
        return f"| {row['design']} | {row['seed']} | {row['refused']} | | | | |"
    then = "" if row["then"] is None else _runs(row["then"]["runs"])
    current = "none" if row["then"] is None else f"{row['current_a']:g} A"
    walks = f"{row['last']:+.2f} | {row['best']:+.2f}"
    return (
        f"| {row['design']} | {row['seed']} | {_runs(row['first']['runs'])} | {current} | {then} | {walks} |"
    )


def _runs(runs: Sequence[dict[str, Any]]) -> str:
    return "; ".join(
        (f"{run['predicted']:+.2f} +- {run['deviation']:.2f}, " if run["predicted"] is not None else "")
        + (f"{run['filmed']:+.2f}" if run["upright"] else "falls")
        for run in runs
    )
