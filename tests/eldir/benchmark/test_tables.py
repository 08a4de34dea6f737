"""The programs that make tables of reference pages."""

import numpy as np
import pytest

from benchmarks import printed_ground, validity
from eldir.benchmark.measurement import small
from eldir.built.robot import build
from eldir.parameters.printed import BuiltParameters
from eldir.scene import Scene
from tests.eldir.built.braced_robots import bodies

PAPER = Scene.preset("paper")


def test_gradients_of_the_paper_s_robots_are_those_of_float64_and_slopes_of_the_loss() -> None:
    """Chaotic ones are not, and have grown more."""
    calm = validity.gradient_errors(PAPER, small(6, 5))
    wild = validity.gradient_errors(PAPER.replace(damping=0.0, dt=0.002, steps=1000), small(6, 5))
    assert np.median(calm.rounding) < 1e-3 and np.median(calm.differences[:, 0]) < 0.1
    assert np.median(wild.growth) > 1e3 * np.median(calm.growth)
    assert np.median(wild.rounding) > 0.1 and np.median(wild.differences[:, 0]) > 0.5
    rows = validity.describe_gradients(
        validity.GradientErrors(
            np.array([1.0, 2.0, 5e6]), np.full(3, 1e-5), np.array([[0, 0], [0, 1], [1, 1]])
        )
    )
    assert rows == [
        "| 0 to 30 | 2 | 1e-05 (1e-05) | 0 % | 50 % |",
        "| 1e+06 to inf | 1 | 1e-05 (1e-05) | 100 % | 100 % |",
    ]


@pytest.mark.parametrize(("speed", "gained"), [(0.1, (0,)), (0.7, (3, 4))])
def test_robots_that_hit_the_ground_too_fast_gain_energy(speed: float, gained: tuple[int, ...]) -> None:
    assert validity.count_gains(validity.impacts()["4 ms, no slip"], speed, 4) in gained


def test_a_terrain_costs_hubs_half_as_much_again() -> None:
    table, rugged = printed_ground.seconds(build(bodies(1, 7)[0], BuiltParameters().with_hubs()), 3)
    assert 1.1 * table < rugged < 3 * table
