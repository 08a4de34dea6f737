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
from typing import Any, TypeVar

from benchmarks.headroom import Search
from benchmarks.hidden_robot import HiddenRig, Rows
from eldir.built.gait import Gait
from eldir.built.samples import RISK
from eldir.errors import InputError
from eldir_calibration.adaptation.runs import Adaptation, AdaptationConfig, SupplyAdvice
from eldir_hardware.planning.compiler import extract_gait
from eldir_hardware.rig.sections import MEASURED_CURRENT
from eldir_hardware.schedule import ActuationSchedule

CYCLES = 3
"""Counted cycles of a filmed run, and of a walk in MuJoCo."""
AnyRig = TypeVar("AnyRig", bound=HiddenRig)


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
        place, found, then = adapt_as_advised(place, config)
    except InputError as error:
        return row | {"refused": str(error), "processor_s": time.process_time() - begin}
    row |= {"first": found.to_json(), "current_a": place.current_a}
    if then is not None:
        row["then"] = then.to_json()
    last = then or found
    row["last"] = _true_walk(place, last)
    row["processor_s"] = time.process_time() - begin
    tried = place.row()
    return row | {"headroom": tried, "best": max(row["last"], tried["best"])}


def adapt_as_advised(place: AnyRig, config: AdaptationConfig) -> tuple[AnyRig, Adaptation, Adaptation | None]:
    """An adaptation, and the one with the current that it advises: a lower one, in the same folder, where
    springs get too hot, or one that is measured. With the rig of the last one."""
    found = place.adapt(config)
    if found.faults and (lower := found.faults[-1].lower_current_a):
        place, more = replace(place, current_a=lower, measured=False), len(found.runs) + config.runs
        return place, found, place.adapt(replace(config, runs=more))
    if advised := _choose(found.advice):
        prior, folder = place.adapted, place.folder / "advised"
        place = replace(place, folder=folder, current_a=advised.current_limit_a)
        return place, found, place.adapt(config, prior=[prior])
    return place, found, None


def _choose(advice: Sequence[SupplyAdvice]) -> SupplyAdvice | None:
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
    file = place.adapted / adaptation.runs[number - 1].schedule
    gait = extract_gait(ActuationSchedule.load(file))
    assert isinstance(gait, Gait)
    walk = place.robot.walk(gait, CYCLES)
    return walk if math.isfinite(walk) else 0.0


def _describe(row: dict[str, Any]) -> str:
    """The row of a rig in the table."""
    if row["refused"]:
        return f"| {row['design']} | {row['seed']} | {row['refused']} | | | | |"
    current, then = "none", ""
    if row["then"] is not None:
        current, then = f"{row['current_a']:g} A", describe_runs(row["then"]["runs"])
    first = describe_runs(row["first"]["runs"])
    walks = f"{row['last']:+.2f} | {row['best']:+.2f}"
    return f"| {row['design']} | {row['seed']} | {first} | {current} | {then} | {walks} |"


def describe_runs(runs: Sequence[dict[str, Any]]) -> str:
    """What was predicted and filmed, run by run."""
    return "; ".join(
        (f"{run['predicted']:+.2f} +- {run['deviation']:.2f}, " if run["predicted"] is not None else "")
        + (f"{run['filmed']:+.2f}" if run["upright"] else "falls")
        for run in runs
    )
