"""Samples of a robot: each motor has its own two springs, within the tolerances of one spring."""

from __future__ import annotations

import numpy as np
import pytest

from eldir.built.samples import NominalRobots
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from tests.eldir.built.robots_alike import NO_ERRORS
from tests.eldir.random_design import make_design
from tests.raised import raises

BODY = make_design(10, Lattice(3, 6)).morphology
NOMINAL = SpringParameters(current_limit=3.45)


def test_the_springs_of_two_motors_are_drawn_independently() -> None:
    """A mean of two has half the variance of one, and two motors are not correlated."""
    robots = NominalRobots(BODY, RobotParameters(springs=NOMINAL), tolerances=NO_ERRORS)
    samples = robots.samples(400, 1)
    hot = np.array([[spring.hot_length for spring in sample.motor_springs(2)] for sample in samples])
    rng = np.random.default_rng(5)
    one = np.std([NOMINAL.perturb(rng).hot_length for _ in range(400)])
    assert hot.mean() == pytest.approx(NOMINAL.hot_length, abs=1e-4)
    assert hot.std(axis=0) == pytest.approx(np.full(2, one / np.sqrt(2)), rel=0.15)
    assert abs(np.corrcoef(hot.T)[0, 1]) < 0.2
    assert {s.motor_springs(2)[0].current_limit for s in samples} == {3.45}, "the supply is the rig's"


def test_a_mean_spring_has_the_means_of_all_numbers() -> None:
    two = [SpringParameters(hot_length=0.07, turns=20), SpringParameters(hot_length=0.08, turns=30)]
    mean = SpringParameters.mean(two)
    assert (mean.hot_length, mean.turns, mean.fan) == (pytest.approx(0.075), 25, two[0].fan)
    assert mean.cold_length == pytest.approx(two[0].cold_length)


def test_own_springs_follow_a_change_and_fit_one_body() -> None:
    sample = NominalRobots(BODY, RobotParameters()).sample(np.random.default_rng(2))
    longer = sample.at(["hot_length"], [1.0])
    for before, after in zip(sample.motor_springs(2), longer.motor_springs(2), strict=True):
        assert after.hot_length == pytest.approx(before.hot_length * np.exp(0.15))
    assert sample.has_individual_parts and not sample.uniform.own_springs
    with raises(InputError, "input.wrong-number", "springs", match="expected 3, one for each motor; found 2"):
        sample.motor_springs(3)
