"""What the public interface refuses in one line, and once met with a traceback or with nonsense."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from eldir.built.gait import Gait, free_lengths
from eldir.built.heat import SpringState, heat, time_to
from eldir.built.robot import build
from eldir.built.walking import walk
from eldir.errors import InputError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.learning import learn, learning_paths
from eldir.morphology import develop
from eldir.parameters.springs import SpringParameters
from eldir.scene import Scene
from eldir.training.configuration import Training
from eldir.training.initial import keys_of
from eldir.training.randomisation import Randomisation
from eldir.trajectory import Trajectory

LATTICE = Lattice(3, 6)
BODY = develop(LATTICE, random_genotypes(LATTICE, 1, np.random.default_rng(10), max_active=2)[0])
ROBOT = build(BODY)
GAIT = Gait(20.0, np.array([0.0, 0.25]), np.array([0.3, 0.3]))
OTHER_GAIT = Gait(20.0, np.zeros(3), np.full(3, 0.3))
SPRING, SCENE = SpringParameters(), Scene().replace(steps=20)
ZEROS, SQUARE = np.zeros(4), np.eye(4)
MARKS = np.zeros((2, 1, 2))

WRONG: dict[str, tuple[Callable[[], object], str]] = {
    "negative seed": (
        lambda: learn([BODY], SCENE, 1, -1),
        "the seed is wrong; expected a whole number of at",
    ),
    "fractional seed": (lambda: learn([BODY], SCENE, 1, 1.5), "the seed is wrong.*found 1.5"),
    "own seeds": (lambda: learn([BODY], SCENE, 1, [-1]), "a robot's seed is wrong"),
    "text as seed": (lambda: learn([BODY], SCENE, 1, "x"), "seed is wrong.*found x"),
    "half an iteration": (lambda: learn([BODY], SCENE, 1.5), "iterations is wrong.*found 1.5"),
    "no step kept": (lambda: learning_paths(BODY, SCENE, 1, 0, every=0), "every is wrong"),
    "paths of -1": (lambda: learning_paths(BODY, SCENE, -1, 0), "iterations is wrong"),
    "no draw": (lambda: Randomisation(ZEROS, SQUARE, 0.0, draws=0), "Randomisation.draws is wrong"),
    "centre": (lambda: Randomisation(ZEROS + np.inf, SQUARE, 0.0), "Randomisation.centre"),
    "covariance": (
        lambda: Randomisation(ZEROS, SQUARE * np.nan, 0.0),
        "covariance: expected finite",
    ),
    "one-sided": (lambda: Randomisation(ZEROS, np.tri(4), 0.0), "covariance is wrong; expected a symmetric"),
    "geometry": (lambda: Randomisation(ZEROS, SQUARE, -0.1), "Randomisation.geometry is wrong"),
    "state": (
        lambda: heat(np.ones((1, 2)), 0.1, SPRING, SpringState.cold(3)),
        "other springs; expected 2; found 3",
    ),
    "no step": (lambda: heat(np.ones((1, 1)), 0.0, SPRING), "heat: the step is wrong"),
    "step back": (lambda: heat(np.ones((1, 1)), -0.1, SPRING), "heat: the step is wrong"),
    "no temperature": (lambda: time_to(np.nan, SPRING), "no such time.*found nan C"),
    "no limit": (lambda: time_to(1e9, SPRING, np.inf), "no such time.*inf s"),
    "terrain": (lambda: Scene().replace(terrain="rugged"), "Scene.terrain is wrong.*Terrain.*'rugged'"),
    "new terrain": (lambda: Scene(terrain="rugged"), "Scene.terrain is wrong"),
    "built": (lambda: Scene().replace(built="hubs"), "Scene.built is wrong.*BuiltParameters.*'hubs'"),
    "update": (lambda: Training(update_length="x"), "Training.update_length is wrong.*'x'"),
    "jump": (lambda: Training(jump_threshold=[0.5]), "Training.jump_threshold is wrong"),
    "ballast": (lambda: build(BODY, ballast=np.ones(3)), "the ballast does not fit the body"),
    "ballast of -1": (lambda: build(BODY, ballast=-1.0), "leaves a mass of nothing"),
    "ballast of nan": (lambda: build(BODY, ballast=np.nan), "leaves a mass of nothing"),
    "no cycle": (lambda: walk(ROBOT, GAIT, cycles=0), "cycles is wrong; expected .* at least 1; found 0"),
    "gaits": (lambda: walk([ROBOT], [GAIT] * 2), "every robot needs one gait; expected 1; found 2"),
    "gait": (lambda: walk(ROBOT, OTHER_GAIT), "gait does not fit .*; expected 2 motors; found 3"),
    "springs": (lambda: free_lengths(GAIT, [SPRING]), "gait does not fit"),
    "no interval": (lambda: free_lengths(GAIT, interval=0), "the interval is wrong"),
    "conditioning": (lambda: free_lengths(GAIT, conditioning=-1), "conditioning is wrong"),
    "times": (lambda: Trajectory(("m1",), [1.0, 0.0], MARKS), "Trajectory.times is wrong"),
    "time of nan": (lambda: Trajectory(("m1",), [0.0, np.nan], MARKS), "Trajectory.times is wrong"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_argument_gets_one_line(name: str) -> None:
    call, says = WRONG[name]
    with pytest.raises(InputError, match=says) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_whole_numbers_of_numpy_are_as_good() -> None:
    assert keys_of(2, np.int64(3)) == [(3, 0), (3, 1)] == keys_of(2, 3)
    assert keys_of(2, np.array([3, 4])) == [(3,), (4,)] == keys_of(2, [np.uint8(3), 4])
    assert type(Randomisation(ZEROS, SQUARE, 0.0, draws=np.int64(2)).draws) is int
