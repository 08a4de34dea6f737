"""The marked masses on hand-made bodies."""

import numpy as np
import pytest

from eldir.design import marked_masses, rear_path
from eldir.genotype import Genotype, random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop


def body(lattice: Lattice, triangles: np.ndarray, motors: list[int]) -> Morphology:
    springs = np.zeros(len(lattice.springs), bool)
    plain = develop(lattice, Genotype(triangles, springs))
    springs[plain.lattice_springs[motors]] = True
    return develop(lattice, Genotype(triangles, springs))


def coordinates(lattice: Lattice, morphology: Morphology, masses: np.ndarray) -> list[list[int]]:
    return lattice.vertices[morphology.vertices[masses]].tolist()


def test_one_triangle_has_two_masses_behind():
    lattice = Lattice(1, 1)
    robot = body(lattice, np.ones((1, 1), bool), [0])  # points down: tip at (0, 0)
    assert coordinates(lattice, robot, marked_masses(robot)) == [[0, 0], [-1, 1]]


def test_a_full_block_gives_its_zigzag_edge_from_the_ground_up():
    lattice = Lattice(4, 6)
    robot = body(lattice, np.ones((4, 6), bool), [])
    want = [[0, 0], [-1, 1], [0, 2], [-1, 3], [0, 4]]
    assert coordinates(lattice, robot, rear_path(robot)) == want
    assert coordinates(lattice, robot, marked_masses(robot)) == want


def test_the_five_nearest_the_motor_are_taken():
    lattice = Lattice(10, 6)
    robot = body(lattice, np.ones((10, 6), bool), [])
    pairs = lattice.vertices[robot.vertices[robot.springs]].tolist()
    at_top = pairs.index([[-1, 9], [0, 10]])
    robot = body(lattice, np.ones((10, 6), bool), [at_top])
    want = [[0, 6], [-1, 7], [0, 8], [-1, 9], [0, 10]]
    assert coordinates(lattice, robot, marked_masses(robot)) == want


def test_equally_near_masses_are_taken_from_below():
    lattice = Lattice(8, 6)
    robot = body(lattice, np.ones((8, 6), bool), [])
    pairs = lattice.vertices[robot.vertices[robot.springs]].tolist()
    # From (0, 4) to (2, 4): path masses (-1, 3) and (-1, 5) are equally near, then (0, 2), (0, 6),
    # then (-1, 1), (-1, 7).
    robot = body(lattice, np.ones((8, 6), bool), [pairs.index([[0, 4], [2, 4]])])
    want = [[0, 2], [-1, 3], [0, 4], [-1, 5], [0, 6]]
    assert coordinates(lattice, robot, marked_masses(robot)) == want


def test_a_bay_in_the_rear_is_followed():
    lattice = Lattice(3, 8)
    triangles = np.ones((3, 8), bool)
    triangles[1, :4] = False
    robot = body(lattice, triangles, [])
    path = coordinates(lattice, robot, rear_path(robot))
    assert path[:2] == [[0, 0], [-1, 1]]
    assert path[-1] == [-1, 3]
    assert max(x for x, _ in path) > 2  # it went into the bay
    assert len(path) == len({tuple(p) for p in path})


def test_a_hinge_is_passed():
    lattice = Lattice(2, 3)
    triangles = np.zeros((2, 3), bool)
    up = next(i for i in range(3) if (i + 0) % 2 == 1)
    triangles[:, up] = True  # tip to tip at (1, 1)
    robot = body(lattice, triangles, [])
    assert coordinates(lattice, robot, rear_path(robot)) == [[0, 0], [1, 1], [0, 2]]
    assert len(marked_masses(robot)) == 3


@pytest.mark.parametrize("seed", range(3))
def test_random_bodies_have_their_marks_behind(seed):
    lattice = Lattice()
    for genotype in random_genotypes(lattice, 15, np.random.default_rng(seed), max_active=2):
        robot = develop(lattice, genotype)
        path = rear_path(robot)
        # Along the path every step is a spring, except where a dead end is left again.
        y = robot.positions[path, 1]
        assert y[0] == robot.positions[:, 1].min()
        assert y[-1] == pytest.approx(robot.positions[:, 1].max())
        rear = robot.positions[:, 0].min()
        assert np.isclose(robot.positions[path, 0].min(), rear)
        marks = marked_masses(robot)
        assert len(marks) == min(5, len(path))
        assert len(set(marks.tolist())) == len(marks)
