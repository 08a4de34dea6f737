"""Coils that buckle, against the differential equation of a column that shears."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from eldir.built.gait import Gait, free_lengths
from eldir.built.motion import PrintedMotion, drive
from eldir.built.robot import PrintedRobot, build, find_shape_fault, rest_state
from eldir.built.walking import coil_load, walk
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from tests.calibration.dynamics.hidden_rigs import walker
from tests.eldir.built.braced_robots import braced, strip

SPRING = SpringParameters()


def haringx_load(coil: float, stiffness: float) -> float:
    """Least load of a pinned coil [N], from the rigidities of a compressed helix: with the length l = L - s,
    bending B l / L, shearing S l / L, compression k L. Haringx: P (1 + P / S l) = pi^2 B / l^2."""
    diameter, per_shear = SPRING.coil_diameter, 1 / 0.376
    # Rigidities of a helix with round wire: B = 2 E I sin a / (2 + nu) and S = E I sin a / (pi R^3).
    compression = stiffness * coil
    bending = compression * diameter**2 / 8 * 2 * per_shear / (1 + per_shear / 2)
    shearing = compression * per_shear

    def excess(load: float) -> float:
        share = 1 - load / compression
        length = coil * share
        return load * (1 + load / (shearing * share)) - np.pi**2 * bending * share / length**2

    return float(brentq(excess, 1e-9, 0.45 * compression))


@pytest.mark.parametrize("coil", [0.04, 0.05, 0.06, 0.08])
def test_the_load_is_that_of_a_column_that_shears(coil: float) -> None:
    shortening = float(SPRING.buckling_shortening(np.array(coil + SPRING.ends)))
    assert 124.0 * shortening == pytest.approx(haringx_load(coil, 124.0), rel=1e-9)


def test_a_hot_coil_buckles_at_a_quarter_of_a_newton_and_a_short_one_never() -> None:
    hot, short = SPRING.buckling_shortening(np.array([0.075, 0.0295]))
    assert 124.0 * hot == pytest.approx(0.25, abs=0.01)
    assert np.isinf(short)
    coil = np.linspace(0.02, 0.5, 200)
    slim = SPRING.buckling_shortening(coil + SPRING.ends) / coil
    assert (np.diff(slim[np.isfinite(slim)]) < 0).all()
    # A slender one is Euler's column, P = pi^2 B / L^2, with B = C D^2 / (2 + 4 G / E).
    euler = (np.pi * SPRING.coil_diameter / coil[-1]) ** 2 / (2 + 4 * 0.376)
    assert slim[-1] == pytest.approx(euler, rel=0.01)


def still(robot: PrintedRobot, instants: int, turned: tuple[float, float] = (0.0, 0.0)) -> PrintedMotion:
    """The robot as assembled, at every instant, its hubs turned."""
    hubs = np.stack([np.cos(turned), np.sin(turned)], axis=1)[:, : 2 * (robot.joints == "hubs")]
    times, state = np.arange(float(instants)), rest_state(robot)
    return PrintedMotion(
        times, *(np.repeat(x[None], instants, axis=0) for x in (robot.positions, hubs)), state, -1
    )


def test_coils_are_measured_between_their_hinges() -> None:
    """One hub is turned by 0.5 rad: its hinge has moved off the line, and the coil is longer than the
    distance of the centres tells."""
    robot = strip((0, 0), (0.07, 0), (1e-3, 1e-3), BuiltParameters().with_hubs())
    robot = replace(robot, active=np.ones(1, bool))
    load = coil_load(robot, still(robot, 1, (0.5, 0.0)), np.array([[0.075]]))
    s = robot.parameters.socket
    between = np.hypot(0.07 - s - s * np.cos(0.5), s * np.sin(0.5))
    expected = (0.075 - 2 * s - between) / SPRING.buckling_shortening(np.array([0.075]))
    assert load[0, 0] == pytest.approx(expected[0], abs=1e-9)
    assert load[0, 0] < coil_load(robot, still(robot, 1), np.array([[0.075]]))[0, 0]


def test_the_load_of_one_coil() -> None:
    robot = strip((0, 0), (0.07, 0), (1e-3, 1e-3), BuiltParameters())
    robot = replace(robot, active=np.ones(1, bool))
    free = np.array([[0.075], [0.070], [0.065]])
    load = coil_load(robot, still(robot, 3), free)
    critical = SPRING.buckling_shortening(np.array([0.075, 0.065]))
    assert load[:, 0] == pytest.approx([0.005 / critical[0], 0.0, -0.005 / critical[1]], abs=1e-9)
    assert load[0, 0] > 1


def test_a_robot_whose_coil_would_buckle_is_not_predicted() -> None:
    """A walker stays below half of the load; its motor between neighbours that hold it goes far beyond."""
    design, gait = walker(), Gait(20.0, np.array([0.0, 0.875]), np.array([0.3, 0.3]))
    robot = build(design.morphology)
    table = free_lengths(gait, SPRING, 1)
    (motion,) = drive([robot], [table.lengths], table.interval, every=20)
    assert 0.1 < coil_load(robot, motion, table.lengths[::20]).max() < 0.5
    assert np.isfinite(walk(robot, gait, cycles=1))
    held = build(braced())
    assert find_shape_fault(held), "the build filter's rigidity tells it too"
    other = Gait(20.0, np.zeros(1), np.array([0.3]))
    table = free_lengths(other, SPRING, 1)
    (motion,) = drive([held], [table.lengths], table.interval, every=20)
    assert coil_load(held, motion, table.lengths[::20]).max() > 3
    assert walk(held, other, cycles=1) == -np.inf
