"""Ties: both outer feet bear about the same load while they slide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldir.built.gait import free_lengths
from eldir.built.motion import drive
from eldir.built.robot import PrintedRobot, build
from eldir.built.samples import NominalRobots, SampledWalks, sample_walks
from eldir.built.screening import candidate_gaits
from eldir.built.walking import MAX_TIE_SHARE, describe_doubt, describe_ties, tie_share
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from tests.calibration.dynamics.hidden_rigs import walker
from tests.eldir.built.braced_robots import strip


def standing(load: float) -> PrintedRobot:
    """Two feet on the table; the front one bears this part of the load."""
    return strip((0, 0), (0.05, 0), (1.0 - load, load), BuiltParameters())


def slid(*steps: tuple[float, float]) -> np.ndarray:
    """Positions of both feet that slide by these distances from one instant to the next."""
    x = np.cumsum([(0.0, 0.05), *steps], axis=0)
    return np.stack([x, np.zeros_like(x)], axis=2)


@pytest.mark.parametrize(("load", "share"), [(0.5, 1.0), (0.46, 1.0), (0.54, 1.0), (0.43, 0.0), (0.57, 0.0)])
def test_both_feet_bear_45_to_55_per_cent(load: float, share: float) -> None:
    assert tie_share(standing(load), slid((0.001, 0.0), (0.0, -0.002), (0.0, 0.0))) == share


def test_it_is_a_share_of_the_sliding_not_of_the_time() -> None:
    """The third mass is lifted; as it moves forward, the load does."""
    robot, x = standing(0.5), slid((0.001, 0.0), (0.0, 0.003))
    three = replace(robot, masses=np.array([1.0, 1.0, 2.0]))
    lifted = np.array([[0.025, 0.02], [0.025, 0.02], [0.048, 0.02]])
    positions = np.concatenate([x, lifted[:, None]], axis=1)
    assert tie_share(three, positions) == pytest.approx(0.25)


def test_without_sliding_or_without_two_feet_there_is_no_tie() -> None:
    robot = standing(0.5)
    assert tie_share(robot, slid((0.0, 0.0))) == 0.0
    airborne = slid((0.01, 0.01))
    airborne[..., 1] = 0.01
    assert tie_share(robot, airborne) == 0.0
    airborne[:, 0, 1] = 0.0
    assert tie_share(robot, airborne) == 0.0


@given(st.integers(0, 10_000))
def test_the_mirror_image_has_the_same_share(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = replace(standing(0.5), masses=rng.uniform(0.1, 1.0, 5))
    positions = np.stack([rng.uniform(0, 0.1, (9, 5)), np.where(rng.random((9, 5)) < 0.6, 0, 0.01)], axis=2)
    share = tie_share(robot, positions)
    assert 0.0 <= share <= 1.0
    assert tie_share(robot, positions * [-1.0, 1.0]) == pytest.approx(share)


def test_friction_from_foot_to_foot_decides_where_ties_do() -> None:
    """Feet that are pushed apart: with even loads the one that grips less slides, with uneven loads the one
    that bears less."""

    def moved(load: float, feet: tuple[float, float]) -> np.ndarray:
        robot = replace(
            strip((0, 0), (0.05, 0), (4e-3 * (1 - load), 4e-3 * load), BuiltParameters()),
            active=np.ones(1, bool),
            buckling=np.array([np.inf]),
            damping=np.array([0.5]),
            feet=np.array(feet),
        )
        longer = np.linspace(0.05, 0.06, 401)[:, None]
        (motion,) = drive([robot], [longer], 0.01, free=(0.05, 0.06))
        return np.abs(motion.positions[-1, :, 0] - robot.positions[:, 0])

    for load, share in ((0.5, 1.0), (0.35, 0.0)):
        rear, front = moved(load, (0.9, 1.1)), moved(load, (1.1, 0.9))
        slips = [bool(x[0] > x[1]) for x in (rear, front)]
        assert slips == ([True, False] if share else [False, False])
        assert tie_share(standing(load), slid((0.0, 0.001))) == share


def test_samples_tell_their_ties() -> None:
    body = walker().morphology
    robots, gait = NominalRobots(body, RobotParameters()), candidate_gaits(body.motors)[7]
    (walks,) = sample_walks(robots, [gait], 6, 4, cycles=2)
    samples = robots.samples(6, 4)
    built = [build(body, sample) for sample in samples]
    tables = [free_lengths(gait, sample.motor_springs(body.motors), 2) for sample in samples]
    free, table = robots.free_lengths_of(samples[0]), tables[0]
    motions = drive(built, [t.lengths for t in tables], table.interval, every=2, free=free)
    assert np.isnan(walks.ties).tolist() == np.isinf(walks.displacement).tolist()
    for ties, robot, motion in zip(walks.ties, built, motions, strict=True):
        if np.isfinite(ties):
            assert ties == tie_share(robot, motion.positions[table.first_cycle // 2 :])
    assert np.isfinite(walks.ties).sum() > 1
    assert walks.tie_share == pytest.approx(np.nanmean(walks.ties))
    assert np.isnan(SampledWalks(np.array([0.1])).tie_share)


def test_words() -> None:
    words = "ties: in 8% of the feet's sliding both outer feet bear about the same load"
    assert describe_ties(0.08) == f"{words} (above 30% a prediction is doubtful)"
    assert describe_ties(MAX_TIE_SHARE + 0.01).endswith("so this prediction is doubtful")
    assert describe_doubt(MAX_TIE_SHARE + 0.01) == describe_ties(MAX_TIE_SHARE + 0.01)
    assert describe_doubt(MAX_TIE_SHARE) == describe_doubt(None) == ""
