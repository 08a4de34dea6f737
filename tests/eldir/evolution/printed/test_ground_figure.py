"""The picture of a robot at the beginning of its terrain."""

from __future__ import annotations

import numpy as np
import pytest

from eldir.built.ground import place
from eldir.built.robot import build
from eldir.evolution.printed.analysis import Elite, bodies_figure, ground_figure
from eldir.evolution.printed.walker import Niche, Walker
from eldir.terrain import Terrain
from tests.eldir.built.grounds import plane
from tests.eldir.evolution.printed.small_searches import BODY, GAIT, genomes


@pytest.mark.parametrize("ends", [0.3, 1e3])
def test_the_robot_stands_on_ground_that_is_drawn_as_far_as_it_may_walk(ends: float) -> None:
    """Not to where its last segment begins, however far that is."""
    robot = build(BODY)
    walker = Walker(1, -1, 0, genomes(1)[0], Niche(1, 1, 1, 1), np.array([1.0]))
    elite = Elite(walker, BODY, robot, GAIT.period, 6.0, GAIT.phase)
    slope = plane(0.1)
    ground = Terrain(np.array([0.0, ends]), np.array([0.1, 0.0]), np.array([0.0, 0.1 * ends]))
    axes = ground_figure(elite, ground).axes[0]
    drawn = np.concatenate([line for springs in axes.collections for line in springs.get_segments()])
    expected = place(robot, slope)[:2].T
    assert {tuple(p) for p in drawn.round(9)} == {tuple(p) for p in expected.round(9)}
    (line,) = axes.lines
    x, y = line.get_data()
    assert y == pytest.approx(0.1 * np.minimum(x, ends))
    front = robot.positions[:, 0].max() + robot.body_length
    assert x.max() == pytest.approx(
        max(0.3 + robot.body_length, front) if ends < 1 else front + 10 * robot.body_length
    )


def test_elites_side_by_side_stand_on_the_terrain() -> None:
    robot, slope = build(BODY), plane(0.1)
    walker = Walker(1, -1, 0, genomes(1)[0], Niche(1, 1, 1, 1), np.array([1.0]))
    elite = Elite(walker, BODY, robot, GAIT.period, 6.0, GAIT.phase)
    for terrain, expected in ((slope, 0.1), (None, 0.0)):
        masses, surface = bodies_figure([elite], terrain).axes[0].lines
        x, y = surface.get_data()
        assert np.diff(y) / np.diff(x) == pytest.approx(expected)
        assert np.ptp(x) == pytest.approx(1.2 * robot.body_length)
        over = np.array(masses.get_data())[1] - np.interp(masses.get_data()[0], x, y)
        assert over.min() == pytest.approx(0.0, abs=1e-9)
