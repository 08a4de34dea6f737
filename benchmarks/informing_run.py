"""`python -m benchmarks.informing_run COMPARISON --out FILE`: does a run that only informs pay? (decision 78)

A wiggle moves each motor alone, with time to cool between. For each rig of a comparison
(`benchmarks.adaptation --compare`) with two filmed gaits it is filmed, too, and four beliefs are compared:
after the first gait, after the wiggle, after both, and after the first and the second gait, which cost as
much. Each predicts the walks of six phases; MuJoCo tells the truth. A rig is a line in FILE.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.adaptation_comparison import CYCLES
from benchmarks.headroom import Search
from benchmarks.hidden_robot import Rows
from eldir.built.gait import PERIOD, Gait
from eldir.built.samples import IdentifiedRobots, sample_walks
from eldir.built.scene import PrintedScene
from eldir.built.screening import candidate_gaits
from eldir.core.records import FloatArray
from eldir_calibration.adaptation.choice import discrepancy
from eldir_calibration.adaptation.films import FilmedWalk, believe_films, read_run
from eldir_calibration.adaptation.prior import BELIEF
from eldir_calibration.adaptation.runs import AdaptationConfig
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.identification.identification import RobotFilms
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.safety.compatibility import with_digests

WIGGLE_PERIOD = 2 * PERIOD
"""Of a wiggle of two motors [s]: each is alone for the usual period."""
PHASES = 6
"""Of the gaits whose walks are predicted."""
_SAMPLES = 8
_LEVEL = 1.96  # standard deviations: 95 %


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.informing_run", description=__doc__)
    parser.add_argument("comparison", type=Path, metavar="COMPARISON", help="folder of a comparison")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="JSON lines, a rig in each")
    given = parser.parse_args(arguments)
    rows = Rows(given.out)
    print("| design | rig | films | error | deviation | within | chosen gait: predicted, walks | best |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for compared in Rows(given.comparison / "comparison.jsonl").read():
        design_file, seed = Path(compared["design"]), compared["seed"]
        row = rows.find(design_file, seed)
        if row is None and len(compared["runs"]) > 1:
            place = Search(design_file, seed, given.comparison / f"{design_file.stem}-{seed}")
            row = _measure(place)
            rows.add(row)
        for line in [] if row is None else _describe(row):
            print(line, flush=True)


def _measure(place: Search) -> dict[str, Any]:
    wiggle, first = (
        read_run(log, place.design, place.rig, _silent) for log in (_film_wiggle(place), _log(place, 1))
    )
    gaits = candidate_gaits(place.design.morphology.motors, PHASES)
    walks = np.array([place.robot.walk(gait, CYCLES) for gait in gaits])
    truth = np.where(np.isfinite(walks), walks, 0.0)
    beliefs = {
        "first": PrintedScene.load(_log(place, 2).with_name(BELIEF)),
        "wiggle": _believe(place, [wiggle]),
        "wiggle, first": _believe(place, [wiggle, first]),
        "first, second": PrintedScene.load(_belief_after_two(place)),
    }
    found = {name: _predict(place, scene, gaits) for name, scene in beliefs.items()}
    return {
        "design": str(place.design_file),
        "seed": place.seed,
        "truth": truth.tolist(),
        "beliefs": {name: {"mean": m.tolist(), "deviation": d.tolist()} for name, (m, d) in found.items()},
    }


def _believe(place: Search, films: Sequence[RobotFilms]) -> PrintedScene:
    scene, _ = believe_films(place.design, place.rig, films, None, AdaptationConfig(), _silent)
    return scene


def _predict(place: Search, scene: PrintedScene, gaits: Sequence[Gait]) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the walk of each gait, predicted by `eldir adapt` with this belief."""
    current, design = place.rig.spring_parameters().current_limit, place.design
    films = [FilmedWalk(film, current) for film in scene.filmed_of(design)]
    bias, error = discrepancy(design, scene, films, current)
    walks = sample_walks(IdentifiedRobots.of(design, scene), gaits, _SAMPLES, 1, cycles=1, coarse=True)
    mean = np.array([one.expected if np.isfinite(one.mean) else 0.0 for one in walks])
    return mean - bias, np.hypot([one.spread_with_falls for one in walks], error)


def _belief_after_two(place: Search) -> Path:
    """That with which the third run was chosen, or else the last one."""
    third = _log(place, 3).with_name(BELIEF)
    return third if third.exists() else place.folder / "adapted" / BELIEF


def _film_wiggle(place: Search) -> Path:
    """The log of a wiggle, which is filmed if there is none."""
    log = place.folder / "wiggle.mcap"
    if log.exists():
        return log
    design, rig, motors = place.design, place.rig, place.design.morphology.motors
    gait = Gait(WIGGLE_PERIOD, np.arange(motors) / motors, np.full(motors, 6.0 / WIGGLE_PERIOD))
    springs, cycles = (
        tuple(int(s) for s in np.flatnonzero(design.morphology.active)),
        DEFAULT_CONFIG.min_cycles,
    )
    schedule = compile_schedule(gait, rig, springs, cycles, {"design": str(place.design_file)})
    schedule = with_digests(schedule, rig, design, None)
    partial = next(p for n in count(1) if not (p := place.folder / f"wiggle-{n}.mcap").exists())
    drive_rig(schedule, rig, place.folder / "rig.yaml", partial, DriveConfig(place.design_file))
    return partial.rename(log)


def _log(place: Search, number: int) -> Path:
    return place.folder / "adapted" / f"run_{number:02d}" / f"run_{number:02d}.mcap"


def _silent(what: str, part: float) -> None:
    """Show nothing."""


def _describe(row: dict[str, Any]) -> list[str]:
    truth, lines = np.array(row["truth"]), []
    for name, belief in row["beliefs"].items():
        mean, deviation = np.array(belief["mean"]), np.array(belief["deviation"])
        off, best = mean - truth, int(mean.argmax())
        within = int((np.abs(off) <= _LEVEL * deviation).sum())
        lines.append(
            f"| {row['design']} | {row['seed']} | {name} | {np.sqrt(np.mean(off**2)):.2f} "
            f"| {deviation.mean():.2f} | {within} of {len(truth)} | {mean[best]:+.2f}, {truth[best]:+.2f} "
            f"| {truth.max():+.2f} |"
        )
    return lines


if __name__ == "__main__":
    main()
