"""Status and flags of results at the edge of what can be computed."""

import pickle

import numpy as np
import pytest

from eldir.engine.validity import NO_GRADIENT, OK, is_chaotic, is_rounded
from eldir.rollout import loss_and_gradient, simulate
from tests.eldir.engine.random_robots import SMALL, robots
from tests.eldir.extreme_scenes import (
    NASTY,
    PAPER,
    RUGGED,
    Extreme,
    assert_honest,
    assert_learns_honestly,
    random_extreme,
)


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("name", NASTY)
def test_a_nasty_scene_is_flagged(name: str, precision: str) -> None:
    """Every robot is, except over 20 000 tiny steps in float64."""
    extreme = NASTY[name]()
    extreme.scene = extreme.scene.replace(precision=precision)
    found = assert_honest(extreme)
    if name != "20 000 steps of 1 us":
        assert ((found.status != OK) | found.chaotic).all()
        assert_learns_honestly(extreme)
    elif precision == "f64":
        assert (found.status == OK).all() and not found.rounded.any()
    else:
        double = loss_and_gradient(
            extreme.bodies, extreme.controllers, extreme.scene.replace(precision="f64"), extreme.physics
        )
        lengths = [np.linalg.norm(b.flat) for b in double[1]]
        errors = [
            np.linalg.norm(a.flat - b.flat) / max(length, 1e-9)
            for a, b, length in zip(found[1], double[1], lengths, strict=True)
        ]
        wrong = np.array(errors) > 0.01
        assert wrong.any() and found.rounded.all()


def test_the_paper_s_robots_are_seldom_flagged() -> None:
    found = loss_and_gradient(*robots(SMALL, 40, 2, PAPER), PAPER)
    assert (found.status == OK).all() and found.chaotic.mean() < 0.2 and found.rounded.mean() < 0.4
    assert (found.growth >= 1).all() and np.median(found.growth) < 1e3
    again = pickle.loads(pickle.dumps(found))
    for key in ("status", "growth", "chaotic", "rounded"):
        assert np.array_equal(getattr(again, key), getattr(found, key))
    assert again[1] == found[1] and np.array_equal(again[0], found[0])


def test_a_chaotic_gradient_is_the_slope_over_a_tiny_change_only() -> None:
    """Central differences in float64 over 1e-5 of the weights, along the gradient."""
    scene = PAPER.replace(damping=2.0, dt=0.002, steps=1000, precision="f64")
    bodies, brains = robots(SMALL, 24, 4, scene)
    found = loss_and_gradient(bodies, brains, scene)
    lengths = np.array([np.linalg.norm(g.flat) for g in found[1]])
    sides = [
        [
            b.shaped(b.flat + sign * 1e-5 * g.flat / length)
            for b, g, length in zip(brains, found[1], lengths, strict=True)
        ]
        for sign in (1, -1)
    ]
    losses = [np.array([r.loss for r in simulate(bodies, side, scene)]) for side in sides]
    known = found.status == OK
    wrong = np.abs((losses[0] - losses[1]) / 2e-5 - lengths) > 0.5 * lengths
    assert found.chaotic[known].any() and not found.chaotic[known].all()
    assert wrong[known & found.chaotic].mean() > 0.6 and wrong[known & ~found.chaotic].mean() < 0.4


def test_an_overflowing_gradient_is_no_gradient() -> None:
    """The rollout itself is complete."""
    extreme = Extreme.of(RUGGED.replace(dt=0.002, steps=2500))
    found = assert_honest(extreme)
    assert (found.status == NO_GRADIENT).any()
    for rollout, status in zip(simulate(*extreme.arguments), found.status, strict=True):
        assert rollout.status == (OK if status == NO_GRADIENT else status)


def test_what_cannot_be_compared_is_flagged() -> None:
    growth = np.array([0.0, 1.0, 1e5, np.inf, np.nan])
    assert is_chaotic(growth).tolist() == [False, False, True, True, True]
    assert is_rounded(growth, PAPER).tolist() == [False, False, True, True, True]
    assert not is_rounded(growth[2], PAPER.replace(precision="f64"))


@pytest.mark.parametrize("seed", range(8))
def test_a_random_extreme_scene_is_honest(seed: int) -> None:
    """`tests/stress` has 300 of them."""
    assert_honest(random_extreme(seed))
    assert_learns_honestly(random_extreme(seed))
