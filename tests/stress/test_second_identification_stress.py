"""Ten robots in MuJoCo with hidden parameters: their next cycle is predicted, or the verdict says otherwise.

What the films have and the identified models lack: contact of hubs, feet that differ and a table that slopes;
pins lack hubs and sockets, too. The filmed run and its prediction share no simulation.
"""

from __future__ import annotations

import os
import time
from typing import NamedTuple

import numpy as np
import pytest

from eldir.built.scene import Identification
from eldir.parameters.robot import RobotParameters
from eldir_calibration.dynamics.recording import FilmedBody
from eldir_calibration.dynamics.results import identify_robot
from eldir_calibration.dynamics.verdict import describe_doubts, describe_model, describe_predictions
from eldir_calibration.identification.identification import OTHER_JOINTS
from tests.calibration.dynamics.hidden_rigs import NOMINAL, PHASE, walker
from tests.calibration.dynamics.mujoco_films import SecondRig, random_body, second_rig

pytest.importorskip("mujoco")
pytestmark = pytest.mark.stress

OTHERS = [RobotParameters(joints) for joints in OTHER_JOINTS]
RANGES, WALK = 0.05, 0.1
ENOUGH = 0.8
"""Part of the rigs within both (docs/reference/dynamics-measured.md)."""
DESIGNS: dict[str, tuple[int, int, float]] = {
    "8 hubs": (33, 212, 0.375),
    "9 hubs": (32, 59, 0.875),
    "9 hubs, ties": (33, 167, 0.75),
    "11 hubs": (32, 9, 0.5),
    "12 hubs": (32, 39, 0.375),
}
"""Seed, number and phase of designs that walk in `screen`, have four marks at least, and whose coils stay
below half of the load at which they buckle."""
RIGS = (
    "8 hubs", "walker", "9 hubs", "9 hubs, ties", "11 hubs", "8 hubs", "12 hubs", "9 hubs", "9 hubs, ties",
    "8 hubs",
)  # fmt: skip
FIRST = 200
"""Seed of the first rig; each has ten seeds, of which the first that gives a robot that walks counts."""


class Outcome(NamedTuple):
    """A rig's held-out cycle against its prediction."""

    ranges: float
    """Error of the vertical ranges, as `eldir calibrate dynamics` prints it."""
    walk: float
    """Error of the walk [body lengths per five cycles]."""
    warned: bool
    """Whether the verdict, or the fitted cycles, had said that predictions are doubtful."""

    @property
    def within(self) -> bool:
        return self.ranges < RANGES and abs(self.walk) < WALK


def named(name: str) -> tuple[FilmedBody, float]:
    if name == "walker":
        return walker(), PHASE
    seed, index, phase = DESIGNS[name]
    return random_body(seed, index), phase


def filmed(number: int) -> tuple[int, SecondRig]:
    body, phase = named(RIGS[number])
    for seed in range(FIRST + 10 * number, FIRST + 10 * number + 10):
        rig = second_rig(body, seed, phase)
        if not rig.fault:
            return seed, rig
        print(f"{RIGS[number]}, seed {seed}: {rig.fault}", flush=True)
    raise AssertionError(f"no robot of {RIGS[number]} walks")


def outcome(results: Identification) -> Outcome:
    held = results.held_out_cycle
    warned = not results.model.predicts or bool(describe_doubts(held))
    return Outcome(held.error_after, held.walk["after"] - held.walk["tracked"], warned)


def test_ten_robots_in_mujoco() -> None:
    outcomes = []
    numbers = os.environ.get("RIGS", ",".join(map(str, range(len(RIGS)))))
    for number in map(int, numbers.split(",")):
        seed, rig = filmed(number)
        began = time.process_time()
        scene = identify_robot(rig.body, [rig.film], NOMINAL, others=OTHERS, measurements=rig.measurements)
        spent = time.process_time() - began
        results, found = scene.results.to_json(), outcome(scene.results)
        outcomes.append(found)
        held = results["held_out_cycle"]
        walk, fitted = held["walk"], held["fitted_cycles"]
        print(
            f"{RIGS[number]}, seed {seed}, table {np.degrees(rig.tilt):+.2f} degrees; {spent:.0f} s of a core"
        )
        print(f"    ranges {held['error_before']:.1%} before, {found.ranges:.1%} after; ", end="")
        print(f"walk {walk['tracked']:+.2f}, predicted {walk['before']:+.2f}, {walk['after']:+.2f}")
        print(f"    fitted cycles: ranges {fitted['range_error']:.1%}, walk {fitted['walk_error']:.2f}")
        for c in results["model"]["tried"]:
            print(
                f"    {c['strips']}{' with parts' * c['parts']}: {1e3 * c['unexplained_m']:.3f} of "
                f"{1e3 * c['limit_m']:.3f} mm unexplained, held out {1e3 * c['held_out_left_m']:.3f} mm"
            )
        for line in describe_model(scene.results.model) + describe_predictions(scene.results):
            print(f"    {line}", flush=True)
    within = [o.within for o in outcomes]
    print(f"{sum(within)} of {len(within)} within {RANGES:.0%} and {WALK} body lengths")
    assert np.mean(within) >= ENOUGH
    assert all(o.warned for o in outcomes if not o.within), "a prediction was wrong and nothing had said so"
