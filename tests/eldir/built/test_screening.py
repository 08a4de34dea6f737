"""Standing, folding, and which designs walk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built import screening
from eldir.built.robot import (
    PrintedRobot,
    build,
    count_mechanisms,
    feet,
    find_held_motors,
    min_area_ratio,
    static_margin,
    triangles,
)
from eldir.built.samples import NominalRobots, SampledWalks, sample_walks
from eldir.built.screening import MARGIN, candidate_gaits, screen
from eldir.built.walking import rotation
from eldir.errors import InputError
from eldir.genotype import random_genotypes
from eldir.morphology import develop
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from tests.eldir.built.braced_robots import LATTICE, body, braced
from tests.raised import raises

SOFT = BuiltParameters(tension=5e3)
"""Soft strips allow long steps: quick."""


def evenly(robot: PrintedRobot) -> PrintedRobot:
    """All masses alike, so that the centre can be told by hand."""
    return replace(robot, masses=np.ones(len(robot.masses)))


def test_a_triangle_stands_on_its_side_and_not_on_its_tip() -> None:
    upright, on_tip = evenly(build(body((0, 1)))), evenly(build(body((0, 2))))
    assert len(feet(upright)) == 2 and len(feet(on_tip)) == 1
    assert static_margin(upright) == pytest.approx(upright.parameters.pitch / 2)
    assert static_margin(on_tip) == pytest.approx(0.0)


def test_a_leaning_tower_falls() -> None:
    # Up, down, up ... one step to the right in every row.
    leaning = evenly(build(body((0, 1), (0, 2), (1, 2), (1, 3), (2, 3), (2, 4), (3, 4), (3, 5))))
    assert static_margin(leaning) < 0


def test_ballast_moves_the_margin() -> None:
    design = body((0, 1), (0, 2), (0, 3))
    light, heavy = build(design), build(design, ballast=0.1)
    assert static_margin(heavy) < static_margin(light)


@pytest.mark.parametrize(
    ("cells", "free"),
    [
        (((0, 1),), 0),
        (((0, 1), (0, 2), (0, 3)), 0),
        (((0, 1), (1, 1)), 1),  # two triangles that share a vertex turn about it
        (((0, 1), (1, 1), (2, 1), (3, 1)), 2),  # two such hinges
    ],
)
def test_freedoms_of_bodies_made_by_hand(cells: tuple[tuple[int, int], ...], free: int) -> None:
    robot = build(body(*cells))
    assert count_mechanisms(robot.positions, robot.springs) == free


def test_a_square_of_four_bars_is_a_mechanism_and_a_diagonal_stops_it() -> None:
    corners = np.array([[0, 0], [0.05, 0], [0.05, 0.05], [0, 0.05]])
    bars = np.array([[0, 1], [1, 2], [2, 3], [0, 3]], np.int32)
    assert count_mechanisms(corners, bars) == 1
    assert count_mechanisms(corners, np.vstack([bars, [[0, 2]]]).astype(np.int32)) == 0


def test_masses_without_any_spring_move_freely() -> None:
    """A body whose springs are all motors: 2 M coordinates but the three rigid motions."""
    corners = np.array([[0, 0], [0.05, 0], [0.025, 0.04]])
    bars = np.array([[0, 1], [0, 2], [1, 2]], np.int32)
    assert count_mechanisms(corners, bars[:0]) == 3
    assert find_held_motors(corners, bars, np.ones(3, bool)).tolist() == []


def test_opening_of_a_triangle_that_folds() -> None:
    robot = build(body((0, 1)))
    assert triangles(robot.springs).tolist() == [[0, 1, 2]]
    rest = robot.positions
    tip = int(rest[:, 1].argmax())
    motion = np.stack([rest, rest, rest])
    motion[1, tip, 1] *= 0.25
    assert min_area_ratio(robot, motion) == pytest.approx(0.25)
    motion[2, tip, 1] *= -0.5
    assert min_area_ratio(robot, motion) == pytest.approx(-0.5)
    angle = 1.0  # turning and moving opens and closes nothing
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert min_area_ratio(robot, (rest @ turn.T + 3.0)[None]) == pytest.approx(1.0)


def test_gaits_to_try() -> None:
    assert len(candidate_gaits(1)) == 1 and len(candidate_gaits(2)) == 12 and len(candidate_gaits(3, 4)) == 16
    phases = np.array([g.phase for g in candidate_gaits(3, 4)])
    assert (phases[:, 0] == 0).all() and len(np.unique(phases, axis=0)) == 16


def test_a_small_screening(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screening, "CYCLES", 1)
    designs = [develop(LATTICE, g) for g in random_genotypes(LATTICE, 8, np.random.default_rng(5), 2)]
    part: list[float] = []
    found = screen(designs, SOFT, phases=2, progress=part.append)
    assert [s.index for s in found] == list(range(8))
    driven = [s for s in found if len(s.displacement)]
    assert driven and any(s.rejected for s in found)
    for s in found:
        robot = build(designs[s.index], SOFT)
        assert s.margin == static_margin(robot)
        if s.margin < MARGIN:
            assert "static margin" in s.rejected and s.gait is None and s.best == -np.inf
    for s in driven:
        assert s.displacement.shape == (2 ** (designs[s.index].motors - 1),)
        assert s.best == s.displacement.max() and s.gait is not None
    assert part == sorted(part) and part[-1] == pytest.approx(1.0)
    alone = driven[0].index
    (again,) = screen(designs[alone : alone + 1], SOFT, phases=2)
    assert replace(again, index=alone) == found[alone]


def test_samples_repeat_and_spread() -> None:
    robots = NominalRobots(body((0, 1), (0, 2), (0, 3), (0, 4), (0, 5)), RobotParameters(SOFT))
    gait = candidate_gaits(2)[2]
    one, two, other = (sample_walks(robots, [gait], n, seed)[0] for n, seed in ((3, 1), (4, 1), (3, 2)))
    assert one.displacement.tobytes() == two.displacement[:3].tobytes()
    assert not np.array_equal(one.displacement, other.displacement)


def test_samples_differ_in_the_friction_of_single_feet() -> None:
    """By 10 per cent from foot to foot, around the friction of the robot; it is what the walk depends on."""
    design = body((0, 1), (0, 2), (0, 3), (0, 4), (0, 5))
    robots = NominalRobots(design, RobotParameters(SOFT))
    samples = robots.samples(200, 3)
    logs = np.log([one.feet for one in samples])
    assert logs.shape == (200, len(design.positions))
    assert logs.std() == pytest.approx(0.1, rel=0.06) and abs(logs.mean()) < 0.01
    assert np.abs(np.corrcoef(logs.T) - np.eye(len(design.positions))).max() < 0.3
    built = build(design, samples[0])
    assert built.friction == pytest.approx(samples[0].feet * samples[0].printed.friction)
    assert samples[0].uniform.feet.size == 0
    with raises(InputError, "input.wrong-number", "feet"):
        build(design, RobotParameters(feet=np.ones(3)))


def test_numbers_of_sampled_walks() -> None:
    some = SampledWalks(np.array([0.5, 0.3, -0.2, -np.inf]))
    assert some.mean == pytest.approx(0.2) and some.fallen == 0.25 and some.expected == pytest.approx(0.15)
    assert some.probability_forward == 0.5
    assert some.spread == pytest.approx(np.std([0.5, 0.3, -0.2], ddof=1))
    assert SampledWalks(np.full(2, -np.inf)).mean == -np.inf


def test_how_far_a_body_is_turned() -> None:
    rest = build(body((0, 1), (0, 2), (0, 3))).positions
    angles = np.array([0.0, 0.5, -1.2, 3.0])
    turns = np.array([[[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]] for a in angles])
    motion = rest @ turns.transpose(0, 2, 1) * 1.1 + [0.3, 0.1]  # larger and elsewhere as well
    assert rotation(rest, motion) == pytest.approx(angles)


def test_a_body_that_its_motors_cannot_move_is_dropped() -> None:
    design = braced()
    assert count_mechanisms(design.positions, design.springs[~design.active]) == 0
    (found,) = screen([design], SOFT, phases=2)
    assert "rigid without its motors" in found.rejected and found.best == -np.inf
    (heavy,) = screen([design], SOFT, phases=2, ballasts=[0.02])
    assert heavy.margin == static_margin(build(design, SOFT, ballast=0.02)) != found.margin
    (walk,) = sample_walks(NominalRobots(design, RobotParameters()), candidate_gaits(1), 1)
    assert walk.displacement[0] == -np.inf  # rightly: its coil would buckle
