"""Coarse robots: softer strips, less damping, and more inertia of the same weight, as if time went slower."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.benchmark.built import SIMPLIFICATIONS, Simplification, mean_walk, walkers
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.built.stability import stable_step
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from tests.eldir.built.braced_robots import bodies, swing
from tests.raised import raises

HUBS = BuiltParameters().with_hubs()


@pytest.mark.parametrize("printed", [BuiltParameters(), HUBS], ids=["pins", "hubs"])
def test_four_times_the_inertia_is_half_the_pace(printed: BuiltParameters) -> None:
    """Without the springs' own dashpots, every force scales: weight, friction, strips, sockets, drag."""
    robot = build(bodies(1, 5)[0], replace(printed, active_damping=0.0))
    table = swing(robot, 81)
    (fast,) = drive([robot], [table], 0.01)
    (slow,) = drive([robot.with_mass_scaling(4.0)], [table], 0.02)
    assert np.abs(fast.positions[-1] - fast.positions[0]).max() > 3e-3  # it does move
    assert slow.positions == pytest.approx(fast.positions, abs=1e-9)
    assert slow.state[2:4] == pytest.approx(fast.state[2:4] / 2, abs=1e-7)


def test_a_robot_that_walks_walks_as_far() -> None:
    """The error of one robot; `eldir benchmark built` measures nine."""
    one = walkers()[4]
    exact, coarse = (
        mean_walk(one, way) for way in (Simplification(True, 1), SIMPLIFICATIONS["hubs, coarse, 1 cycle"])
    )
    assert exact > 0.9
    assert coarse == pytest.approx(exact, abs=0.1)


def test_coarse_robots_have_longer_steps_the_same_weight_and_springs() -> None:
    body = bodies(1, 5)[0]
    hubs, pins = build(body, HUBS), build(body)
    longer = stable_step(hubs.coarse()) / stable_step(hubs)
    assert longer > 4.0 and stable_step(pins.coarse()) > 2 * stable_step(pins)
    for robot in (hubs, pins):
        coarse = robot.coarse()
        weight = coarse.masses * coarse.parameters.gravity
        assert weight == pytest.approx(robot.masses * robot.parameters.gravity, rel=1e-12)
        assert np.array_equal(coarse.rest_lengths, robot.rest_lengths)
        assert np.array_equal(coarse.positions, robot.positions) and np.array_equal(coarse.feet, robot.feet)
        motors = robot.active
        assert np.array_equal(coarse.damping[motors], robot.damping[motors])
        assert (coarse.stiffness[~motors] == 20e3).all() and (coarse.stiffness[motors] > 100).all()
    assert np.array_equal(pins.coarse().masses, pins.masses), "pins would fold"
    clamped = build(body, BuiltParameters.clamped())
    assert clamped.coarse() is clamped


def test_a_soft_robot_is_not_made_stiffer() -> None:
    robot = build(bodies(1, 5)[0], replace(HUBS, tension=5e3))
    assert (robot.coarse().stiffness[~robot.active] == 5e3).all()


def test_lighter_masses_are_refused() -> None:
    with raises(InputError, "input.wrong-value", "factor"):
        build(bodies(1, 5)[0]).with_mass_scaling(0.5)
