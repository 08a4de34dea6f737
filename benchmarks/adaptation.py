"""`python -m benchmarks.adaptation DESIGN...`: robots that learn on rigs unlike the kit (decision 63).

Each design stands on virtual rigs with `parameter_spread: large`, moved by MuJoCo, where `eldir adapt` makes
its runs. With `--exhaustive` all phases are played on the same rig, and the best true walk is printed beside
that of the schedule with which the adaptation ended. With `--compare` it is compared with a search without
a model and with a model without films (`benchmarks.adaptation_comparison`); a rig is then a line in
comparison.jsonl, and a later call computes those that are not in it. With `--follow-advice` the robot is
adapted again on the rig that the adaptation advises (`benchmarks.adaptation_advice`).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.adaptation_advice import adapt_as_advised, follow_advice
from benchmarks.adaptation_comparison import compare
from benchmarks.hidden_robot import HiddenRig
from eldir.built.robot import build
from eldir.built.screening import candidate_gaits
from eldir.core.files import write_text
from eldir_calibration.adaptation.runs import AdaptationConfig
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.plan import heating_limits
from eldir_hardware.rig.template import CURRENT_LIMIT_A
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.rig import BodyFrame


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table, and write adaptation-benchmark.json into `--out`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.adaptation", description=__doc__)
    parser.add_argument("designs", nargs="+", type=Path, metavar="DESIGN", help="design.json of packets")
    parser.add_argument("--out", type=Path, required=True, help="folder to create")
    parser.add_argument("--seeds", nargs="+", type=int, default=[11, 12], help="of the rigs")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument(
        "--current", type=float, default=CURRENT_LIMIT_A, help="current limit of the rigs [A]"
    )
    parser.add_argument("--exhaustive", action="store_true")
    parser.add_argument("--compare", action="store_true", help="with other ways to spend the runs")
    parser.add_argument("--follow-advice", action="store_true", help="then with the current that it advises")
    given = parser.parse_args(arguments)
    designs = [file.resolve() for file in given.designs]
    if given.compare:
        compare(designs, given.seeds, given.runs, given.out)
        return
    if given.follow_advice:
        follow_advice(designs, given.seeds, given.runs, given.out)
        return
    rows: list[dict[str, Any]] = []
    print("| design | rig | runs: predicted, filmed | last schedule | best of all phases | processor [s] |")
    print("| --- | --- | --- | --- | --- | --- |")
    for design_file in designs:
        for seed in given.seeds:
            bench = Bench(design_file, seed, given.out / f"{len(rows) + 1:02d}", given.current)
            rows.append(bench.row(given.runs, given.exhaustive))
            print(_describe(rows[-1]), flush=True)
    write_text(given.out / "adaptation-benchmark.json", json.dumps(rows, indent=2) + "\n")


@dataclass(frozen=True)
class Bench(HiddenRig):
    """An adaptation on a hidden rig, and what the robot truly walks there."""

    def row(self, runs: int, exhaustive: bool, *, as_advised: bool = False) -> dict[str, Any]:
        """An adaptation, and the walks of its last schedule and of all phases. `as_advised`: another one with
        the current that it advises, if any, whose walks count."""
        begin, config = time.process_time(), AdaptationConfig(runs=runs)
        place, first, then = (
            adapt_as_advised(self, config) if as_advised else (self, self.adapt(config), None)
        )
        last_one, used = then or first, time.process_time() - begin
        number = last_one.best or len(last_one.runs)
        last = place.true_walk(ActuationSchedule.load(place.adapted / last_one.runs[number - 1].schedule))
        walks = place._all_phases() if exhaustive else []
        return {
            "design": str(self.design_file),
            "seed": self.seed,
            "current_a": place.current_a,
            **first.to_json(),
            "then": None if then is None else then.to_json(),
            "last": last,
            "best_of_all_phases": max([last, *walks]) if walks else None,
            "processor_s": used,
        }

    def true_walk(self, schedule: ActuationSchedule) -> float:
        """Walk of the virtual robot itself, not as filmed [body lengths per five cycles]."""
        frames: list[BodyFrame] = []
        assert self.rig.camera is not None
        camera = self.rig.camera.model_copy(update={"rate_hz": 1.0})  # pictures are not needed
        log = self.folder / "true-walk.mcap"
        driving = DriveConfig(self.design_file, on_body=frames.append)
        drive_rig(schedule, self.rig.model_copy(update={"camera": camera}), self.rig_file, log, driving)
        log.unlink()
        t = np.array([frame.time_s for frame in frames])
        x = np.array([frame.positions for frame in frames])[:, self.design.marks, 0].mean(axis=1)
        moved = np.interp(schedule.duration, t, x) - np.interp(schedule.start_of_cycles, t, x)
        return float(moved / build(self.design.morphology).body_length * 5 / schedule.cycles)

    def _all_phases(self) -> list[float]:
        allowed = heating_limits(self.rig).allowed
        springs = tuple(int(s) for s in np.flatnonzero(self.design.morphology.active))
        provenance = {"design": str(self.design_file)}
        return [
            self.true_walk(
                with_digests(
                    compile_schedule(gait, self.rig, springs, 5, provenance), self.rig, self.design, None
                )
            )
            for gait in candidate_gaits(self.design.morphology.motors)
            if allowed(gait)
        ]


def _describe(row: dict[str, Any]) -> str:
    runs = "; ".join(
        f"{r['predicted']:+.2f} +- {r['deviation']:.2f}, {r['filmed']:+.2f}" for r in row["runs"]
    )
    best = "" if row["best_of_all_phases"] is None else f"{row['best_of_all_phases']:+.2f}"
    where = f"{row['design']} | {row['seed']}"
    return f"| {where} | {runs} | {row['last']:+.2f} | {best} | {row['processor_s']:.0f} |"


if __name__ == "__main__":
    main()
