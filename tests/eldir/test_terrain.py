"""Rugged ground: slopes, lengths and heights as the paper has them, over many random ones."""

import numpy as np
import pytest

from eldir.terrain import Terrain

TILTS = {"level": 0.0, "rising": 0.2, "falling": -0.2}
GROUNDS = {
    name: [Terrain.rugged(np.random.default_rng(i), tilt) for i in range(200)] for name, tilt in TILTS.items()
}


@pytest.mark.parametrize("name", TILTS)
def test_segments_join_and_the_ground_outside_is_level(name):
    for ground in GROUNDS[name]:
        ends = ground.x0[1:]
        assert ground.height(ends - 1e-12) == pytest.approx(ground.height(ends), abs=1e-9)
        assert ground.slope[0] == ground.slope[-1] == 0
        assert ground.height(np.array([-5.0, 0.0])) == pytest.approx(0.4 if name == "falling" else 0.1)
        assert 1.25 <= ends[-1] < 1.25 + 0.07
        assert (np.diff(ends) >= 0.02 - 1e-9).all() and (np.diff(ends) <= 0.07 + 1e-9).all()


@pytest.mark.parametrize("name", TILTS)
def test_slopes_are_up_to_a_half_either_way_from_the_tilt(name):
    """As often up as down: what is turned away at the floor and at the ceiling moves the mean a little."""
    steepness = np.concatenate([g.slope[1:-1] for g in GROUNDS[name]]) - TILTS[name]
    assert steepness.min() == pytest.approx(-0.5, abs=0.01) and steepness.min() >= -0.5
    assert steepness.max() == pytest.approx(0.5, abs=0.01) and steepness.max() <= 0.5
    assert np.abs(steepness.mean()) < 0.1


def test_the_ground_is_nowhere_below_zero_or_above_half_a_metre_and_uses_that_room():
    low, high = (
        find([find(g.height(g.x0)) for grounds in GROUNDS.values() for g in grounds]) for find in (min, max)
    )
    assert 0 <= low < 0.01 and 0.49 < high <= 0.5
