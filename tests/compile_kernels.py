"""Compile the kernels that most tests use, before the tests: `python -m tests.compile_kernels`.

Each takes 5 to 15 s, from the cache half of that. Without this, every worker of pytest and every program that
a test starts would compile the same ones, because the compiler writes its cache only when a process ends. A
kernel that only one process needs is not here.
"""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.built.sensitivities import DriveInputs, sensitivities
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.rollout import loss_and_gradient
from eldir.scene import Scene
from eldir.terrain import Terrain
from eldir.training.gradients import motion_gradient
from tests.eldir.built.braced_robots import COLD, braced
from tests.eldir.engine.random_robots import SMALL, robots


def learning(precision: str, contact: str, integrator: str) -> None:
    """Learning over a few steps."""
    scene = Scene(precision=precision, contact=contact, integrator=integrator, steps=3)
    loss_and_gradient(*robots(SMALL, 1, 1, scene), scene)


def physical(precision: str, contact: str) -> None:
    """Gradients of physics over a few steps."""
    scene = Scene(precision=precision, contact=contact, steps=3)
    motion_gradient(*robots(SMALL, 1, 1, scene), scene)


def printed(parameters: BuiltParameters, sloped: bool, terrain: Terrain | None = None) -> None:
    """A heated robot for an instant."""
    robot = build(braced(), RobotParameters(parameters))
    lengths = np.full((2, 1), COLD)
    if sloped:
        sensitivities([DriveInputs(robot, lengths, 1e-3, terrain=terrain)], [["friction"]])
    else:
        drive([robot], [lengths], 1e-3, terrain=terrain)


PINS = BuiltParameters()
KERNELS = [
    (learning, "f64", "no-slip", "paper"),
    (physical, "f64", "no-slip"),
    (physical, "f32", "no-slip"),
    (learning, "f64", "friction", "paper"),
    (physical, "f64", "friction"),
    (learning, "f64", "no-slip", "second-order"),
    (learning, "f64", "friction", "second-order"),
    (learning, "f64", "none", "paper"),
    (learning, "f32", "none", "paper"),
    (learning, "f32", "no-slip", "paper"),
    (learning, "f32", "friction", "paper"),
    (learning, "f32", "no-slip", "second-order"),
    (printed, PINS, True),
    (printed, PINS.with_hubs(), True),
    (printed, PINS.with_hubs(), False),
    (printed, PINS, False),
    (printed, BuiltParameters.clamped(), True),
    (printed, BuiltParameters.clamped(), False),
    (printed, PINS, False, Terrain.flat()),
    (printed, PINS.with_hubs(), False, Terrain.flat()),
]


def main(part: str = "") -> int:
    """Two processes, half the kernels each; status 0."""
    if part:
        for function, *arguments in KERNELS[int(part) :: 2]:
            function(*arguments)
        return 0
    # No multiprocessing: its processes end without the compiler's farewell, which writes the cache.
    halves = [subprocess.Popen([sys.executable, "-m", "tests.compile_kernels", str(i)]) for i in range(2)]
    return max(half.wait() for half in halves)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
