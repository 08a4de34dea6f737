"""What the public interface refuses in one line, and once met with a traceback or with nonsense."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from eldir.built.gait import Gait, free_lengths
from eldir.built.heat import SpringState, heat, heating_time
from eldir.built.robot import build
from eldir.built.walking import walk
from eldir.errors import InputError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.learning import learn, learning_paths
from eldir.morphology import develop
from eldir.parameters.springs import SpringParameters
from eldir.scene import Scene
from eldir.training.configuration import TrainingConfig
from eldir.training.loop import make_seed_keys
from eldir.training.randomisation import Randomisation
from eldir.trajectory import Trajectory
from tests.raised import raises

LATTICE = Lattice(3, 6)
BODY = develop(LATTICE, random_genotypes(LATTICE, 1, np.random.default_rng(10), max_active=2)[0])
ROBOT = build(BODY)
GAIT = Gait(20.0, np.array([0.0, 0.25]), np.array([0.3, 0.3]))
OTHER_GAIT = Gait(20.0, np.zeros(3), np.full(3, 0.3))
SPRING, SCENE = SpringParameters(), Scene().replace(steps=20)
ZEROS, SQUARE = np.zeros(4), np.eye(4)
MARKS = np.zeros((2, 1, 2))

VALUE, SHAPE, NUMBER = "input.wrong-value", "input.wrong-shape", "input.wrong-number"
RANDOM = "randomisation"
WRONG: dict[str, tuple[Callable[[], object], str, str]] = {
    "negative seed": (lambda: learn([BODY], SCENE, 1, -1), VALUE, "seed"),
    "fractional seed": (lambda: learn([BODY], SCENE, 1, 1.5), VALUE, "seed"),
    "own seeds": (lambda: learn([BODY], SCENE, 1, [-1]), VALUE, "seed of a robot"),
    "text as seed": (lambda: learn([BODY], SCENE, 1, "x"), VALUE, "seed of a robot"),
    "half an iteration": (lambda: learn([BODY], SCENE, 1.5), VALUE, "iterations"),
    "no step kept": (lambda: learning_paths(BODY, SCENE, 1, 0, every=0), VALUE, "every"),
    "paths of -1": (lambda: learning_paths(BODY, SCENE, -1, 0), VALUE, "iterations"),
    "no draw": (lambda: Randomisation(ZEROS, SQUARE, 0.0, samples=0), f"{RANDOM}.wrong-value", "samples"),
    "centre": (lambda: Randomisation(ZEROS + np.inf, SQUARE, 0.0), f"{RANDOM}.inconsistent", "centre"),
    "covariance": (
        lambda: Randomisation(ZEROS, SQUARE * np.nan, 0.0),
        f"{RANDOM}.inconsistent",
        "covariance",
    ),
    "one-sided": (
        lambda: Randomisation(ZEROS, np.tri(4), 0.0),
        f"{RANDOM}.inconsistent",
        "Randomisation.covariance",
    ),
    "geometry": (lambda: Randomisation(ZEROS, SQUARE, -0.1), f"{RANDOM}.wrong-value", "geometry"),
    "state": (
        lambda: heat(np.ones((1, 2)), 0.1, SPRING, SpringState.cold(3)),
        NUMBER,
        "temperatures in the state",
    ),
    "no step": (lambda: heat(np.ones((1, 1)), 0.0, SPRING), VALUE, "dt"),
    "step back": (lambda: heat(np.ones((1, 1)), -0.1, SPRING), VALUE, "dt"),
    "no temperature": (lambda: heating_time(np.nan, SPRING), VALUE, "temperature"),
    "no limit": (lambda: heating_time(1e9, SPRING, np.inf), VALUE, "limit"),
    "terrain": (lambda: Scene().replace(terrain="rugged"), "scene.wrong-value", "terrain"),
    "new terrain": (lambda: Scene(terrain="rugged"), "scene.wrong-value", "terrain"),
    "built": (lambda: Scene().replace(built="hubs"), "scene.wrong-value", "built"),
    "update": (lambda: TrainingConfig(update_length="x"), "training.wrong-value", "update_length"),
    "jump": (lambda: TrainingConfig(jump_threshold=[0.5]), "training.wrong-value", "jump_threshold"),
    "ballast": (lambda: build(BODY, ballast=np.ones(3)), SHAPE, "ballast"),
    "ballast of -1": (lambda: build(BODY, ballast=-1.0), VALUE, "ballast"),
    "ballast of nan": (lambda: build(BODY, ballast=np.nan), VALUE, "ballast"),
    "no cycle": (lambda: walk(ROBOT, GAIT, cycles=0), VALUE, "cycles"),
    "gaits": (lambda: walk([ROBOT], [GAIT] * 2), NUMBER, "gaits"),
    "gait": (lambda: walk(ROBOT, OTHER_GAIT), NUMBER, "phases in the gait"),
    "springs": (lambda: free_lengths(GAIT, [SPRING]), NUMBER, "phases in the gait"),
    "no interval": (lambda: free_lengths(GAIT, interval=0), VALUE, "interval"),
    "conditioning": (lambda: free_lengths(GAIT, conditioning=-1), VALUE, "conditioning"),
    "times": (lambda: Trajectory(("m1",), [1.0, 0.0], MARKS), "trajectory.inconsistent", "Trajectory.times"),
    "time of nan": (lambda: Trajectory(("m1",), [0.0, np.nan], MARKS), "trajectory.inconsistent", "times"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_argument_gets_one_line(name: str) -> None:
    call, code, key = WRONG[name]
    with raises(InputError, code, key):
        call()


def test_whole_numbers_of_numpy_are_as_good() -> None:
    assert make_seed_keys(2, np.int64(3)) == [(3, 0), (3, 1)] == make_seed_keys(2, 3)
    assert make_seed_keys(2, np.array([3, 4])) == [(3,), (4,)] == make_seed_keys(2, [np.uint8(3), 4])
    assert type(Randomisation(ZEROS, SQUARE, 0.0, samples=np.int64(2)).samples) is int
