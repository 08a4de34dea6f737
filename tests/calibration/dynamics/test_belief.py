"""The belief after a film: ensemble Kalman inversion against closed forms, and a robot that a film shows."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from eldir.built.walking import TOPPLED_ANGLE, rotation
from eldir.parameters.robot import QUANTITIES, RobotParameters
from eldir.trajectory import Trajectory
from eldir_calibration.dynamics._ensemble import next_share, update
from eldir_calibration.dynamics.belief import Belief, BeliefConfig, believe
from eldir_calibration.dynamics.recording import (
    Measurements,
    Recording,
    find_fall,
    predict_markers,
)
from tests.calibration.dynamics.hidden_rigs import film, walker
from tests.raised import raises

NOMINAL = replace(RobotParameters(), printed=RobotParameters().printed.with_hubs())
OFF = {"hot_length": -1.2, "cold_length": 0.8, "current": 0.7, "friction": 0.6}
TRUTH = NOMINAL.at(tuple(OFF), list(OFF.values()))
SMALL = BeliefConfig(members=32)


@pytest.mark.parametrize("shares", [(1.0,), (0.2, 0.3, 0.5)], ids=["one step", "three"])
def test_the_posterior_of_a_linear_model_is_the_closed_form(shares: tuple[float, ...]) -> None:
    """Prior N(0, 1), residuals y - A z: covariance C = (1 + A'A)^-1, mean C A'y; however the data enter."""
    rng = np.random.default_rng(3)
    matrix, data, z = (
        rng.standard_normal((5, 2)),
        np.array([2.0, -1.0, 0.5, 3.0, 1.0]),
        rng.standard_normal((800, 2)),
    )
    for share in shares:
        z = update(z, data - z @ matrix.T, share, rng)
    covariance = np.linalg.inv(np.eye(2) + matrix.T @ matrix)
    assert z.mean(axis=0) == pytest.approx(covariance @ matrix.T @ data, abs=0.12)
    assert np.cov(z.T) == pytest.approx(covariance, abs=0.04)


def test_the_bytes_do_not_depend_on_the_threads_of_blas() -> None:
    program = (
        "import numpy as np\n"
        "from eldir_calibration.dynamics._ensemble import update\n"
        "rng = np.random.default_rng(0)\n"
        "z, residuals = rng.standard_normal((64, 30)), rng.standard_normal((64, 18000))\n"
        "print(update(z, residuals, 0.4, rng).tobytes().hex())"
    )
    found = [
        subprocess.run(
            [sys.executable, "-c", program],
            env=os.environ | {"OPENBLAS_NUM_THREADS": threads},
            capture_output=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    ]
    assert found[0] == found[1] and len(found[0]) > 1000


def test_a_step_uses_the_less_the_worse_the_members_fit() -> None:
    rng = np.random.default_rng(1)
    good, bad = (factor * rng.chisquare(50, 200) for factor in (0.5, 20.0))
    assert next_share(good, 50.0, 1.0) == 1.0 and next_share(good, 50.0, 0.3) == 0.3
    assert next_share(bad, 50.0, 1.0) == pytest.approx(50 / bad.mean(), rel=0.05)
    assert 0.0 < next_share(1e6 * bad, 50.0, 1.0) < 1e-3
    assert next_share(np.full(8, 2e3), 50.0, 1.0) == 1.0, "members that all predict the same have learned all"


@pytest.fixture(scope="module")
def seen() -> Recording:
    return film(walker(), TRUTH, 1, 2)


@pytest.fixture(scope="module")
def belief(seen: Recording) -> Belief:
    return believe(walker(), [seen], NOMINAL, config=SMALL)


def test_the_filmed_robot_is_among_those_that_are_believed(belief: Belief) -> None:
    """What a film shows is found within its spread, which is less than before; the rest keeps its prior."""
    found = dict(
        zip(belief.names, zip(belief.z.mean(axis=0), belief.z.std(axis=0), strict=True), strict=True)
    )
    for name in ("hot_length", "current"):
        mean, deviation = found[name]
        assert abs(mean - OFF[name]) < 3 * deviation and deviation < 0.6, name
    assert np.mean([deviation for name, (_, deviation) in found.items() if name in ("weight", "heat")]) > 0.6
    assert belief.explains and belief.scene.model_fits


def test_the_belief_predicts_a_gait_that_it_never_saw(belief: Belief) -> None:
    """With other phases and times, by exact robots: a third of the nominal robot's error at most."""
    other = film(walker(), TRUTH, 2, 1, phase=0.4, period=24.0, noise=0.0, hidden_share=0.0)
    robots = [NOMINAL, belief.scene.robot]
    nominal, found = predict_markers(walker(), [other], robots)[0] - other.tracked.positions
    before, after = (float(np.sqrt(np.nanmean(x**2))) for x in (nominal, found))
    assert after < before / 3, (before, after)


def test_the_scene_of_a_belief_is_its_mean_and_covariance(belief: Belief) -> None:
    scene = belief.scene
    count = len(scene.parameters)
    assert scene.parameters == belief.names[:count] and all(" " in name for name in belief.names[count:])
    assert scene.z == pytest.approx(belief.z.mean(axis=0)[:count])
    assert scene.covariance == pytest.approx(np.cov(belief.z[:, :count].T))
    own = scene.robot.motor_springs(2)
    mean = np.mean([spring.hot_length for spring in own])
    assert mean == pytest.approx(QUANTITIES["hot_length"].value(scene.robot), rel=1e-3)
    worse = replace(belief, misfit=4.0)
    assert worse.scene.covariance == pytest.approx(4 * scene.covariance) and not worse.scene.model_fits


def test_the_same_film_and_seed_give_the_same_belief(seen: Recording) -> None:
    few = BeliefConfig(members=8, max_steps=1)
    short = seen.truncate(seen.start)
    one, again, other = (believe(walker(), [short], NOMINAL, seed=seed, config=few).z for seed in (0, 0, 1))
    assert (one == again).all() and not np.allclose(one, other)


def test_a_measured_current_is_believed(seen: Recording) -> None:
    """Before anything moved, so that the meter alone says it."""
    still = seen.truncate(2.0)
    amperes = 1.1 * float(NOMINAL.springs.current(0.0))
    found = believe(
        walker(),
        [still],
        NOMINAL,
        measurements=Measurements(current=amperes),
        config=BeliefConfig(members=64),
    )
    assert found.scene.robot.springs.current(0.0) == pytest.approx(amperes, rel=0.02)


def test_a_film_of_nothing_that_could_be_this_robot_is_refused(seen: Recording) -> None:
    """Members whose springs have no stroke count as lost."""
    flat = replace(NOMINAL, springs=replace(NOMINAL.springs, hot_length=NOMINAL.springs.cold_length + 1e-3))
    with raises(Exception, "dynamics.unexplained"):
        believe(walker(), [seen.truncate(2.0)], flat, config=BeliefConfig(members=8, min_stroke=0.02))


def test_a_fall_has_a_time() -> None:
    """A square on its side from the third second on, and a marker that is mistaken for half a second."""
    rest = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
    times = np.arange(0.0, 6.0, 0.1)
    turned = rest @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    falls, stands = (np.tile(rest, (len(times), 1, 1)) for _ in range(2))
    falls[times >= 3.0] = turned
    stands[20:25] = turned
    names = ("m1", "m2", "m3", "m4")
    assert find_fall(rest, Trajectory(names, times, falls)) == pytest.approx(3.0)
    assert find_fall(rest, Trajectory(names, times, stands)) is None


def test_a_limb_that_swings_is_no_fall() -> None:
    """A body with three markers stands, and its motor swings the rear one by 100 degrees about the middle."""
    rest = np.array([[0.0, 0.0], [0.02, 0.05], [0.03, 0.1]])
    times = np.arange(0.0, 30.0, 0.1)
    angle = np.deg2rad(-100.0) * np.sin(np.pi * times / 30.0) ** 2
    arm = rest[0] - rest[1]
    turned = np.stack(
        [np.cos(angle) * arm[0] - np.sin(angle) * arm[1], np.sin(angle) * arm[0] + np.cos(angle) * arm[1]], 1
    )
    swings = np.tile(rest, (len(times), 1, 1))
    swings[:, 0] = rest[1] + turned
    assert np.abs(rotation(rest, swings)).max() > TOPPLED_ANGLE, "of all markers taken for one rigid body"
    assert find_fall(rest, Trajectory(("m1", "m2", "m3"), times, swings)) is None
    lying = swings @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert find_fall(rest, Trajectory(("m1", "m2", "m3"), times, lying)) is not None
