"""More inertia with the same weight: as if time went slower, and hardly another walk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.benchmark.built import Simplification, mean_walk, walkers
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from tests.eldir.built.braced_robots import COLD, bodies, swing
from tests.raised import raises

HUBS = BuiltParameters().with_hubs()


@pytest.mark.parametrize("printed", [BuiltParameters(), HUBS], ids=["pins", "hubs"])
def test_four_times_the_inertia_is_half_the_pace(printed: BuiltParameters) -> None:
    """Without the springs' own dashpots, every force scales: weight, friction, strips, sockets, drag."""
    robot = build(bodies(1, 5)[0], replace(printed, active_damping=0.0))
    table = swing(robot, 81)
    (fast,) = drive([robot], [table], 0.01)
    (slow,) = drive([robot], [table], 0.02, mass_scaling=4.0)
    assert np.abs(fast.positions[-1] - fast.positions[0]).max() > 3e-3  # it does move
    assert slow.positions == pytest.approx(fast.positions, abs=1e-9)
    assert slow.state[2:4] == pytest.approx(fast.state[2:4] / 2, abs=1e-7)


def test_a_robot_that_walks_walks_as_far() -> None:
    """The error of one robot with softer strips, for longer steps; `eldir benchmark built` measures nine."""
    one = walkers()[4]
    exact, heavier = (mean_walk(one, Simplification(True, 40e3, 1, f)) for f in (1.0, 9.0))
    assert exact > 1.2
    assert heavier == pytest.approx(exact, abs=0.1)


def test_lighter_masses_are_refused() -> None:
    robot = build(bodies(1, 5)[0])
    with raises(InputError, "input.wrong-value", "mass_scaling"):
        drive([robot], [np.full((2, int(robot.active.sum())), COLD)], 0.05, mass_scaling=0.5)
