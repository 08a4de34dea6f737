"""Bodies on a grid of cells: every mass has its own, and springs are constant shifts."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.engine.grid import place_on_grids
from eldir.errors import InputError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Bodies, Morphology, develop
from tests.raised import raises


@given(rows=st.integers(1, 14), columns=st.integers(1, 24), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_springs_are_shifts(rows: int, columns: int, seed: int) -> None:
    lattice = Lattice(rows, columns)
    (genotype,) = random_genotypes(lattice, 1, np.random.default_rng(seed))
    body = develop(lattice, genotype)
    (grid,) = place_on_grids(Bodies([body]))
    assert len(set(grid.cell.tolist())) == len(body.positions)
    assert grid.cell.min() == 0 and grid.cell.max() == grid.cell_count - 2
    shift = np.array([1, grid.reach, grid.reach + 1])[grid.family]
    ends = np.sort(np.stack([grid.first, grid.first + shift], axis=1), axis=1)
    assert (ends == np.sort(grid.cell[body.springs], axis=1)).all()
    x, y = lattice.vertices[body.vertices].T
    for k in range(1, grid.reach):  # would give two masses the same cell
        assert len(set(((x - y) // 2 + (k + 1) * y).tolist())) < len(body.positions)


def test_the_paper_s_bodies_are_packed_densely() -> None:
    bodies = [develop(Lattice(), g) for g in random_genotypes(Lattice(), 32, np.random.default_rng(0))]
    cells = sum(grid.cell_count for grid in place_on_grids(Bodies(bodies)))
    assert cells < 1.45 * sum(len(body.positions) for body in bodies)


def test_springs_between_others_than_neighbours_are_refused() -> None:
    body = develop(Lattice(3, 5), random_genotypes(Lattice(3, 5), 1, np.random.default_rng(1))[0])
    springs = body.springs.copy()
    springs[0] = 0, len(body.positions) - 1
    wrong = Morphology(
        body.positions, springs, body.rest_lengths, body.active, body.vertices, body.lattice_springs
    )
    with raises(InputError, "body.no-lattice"):
        place_on_grids(Bodies([wrong]))
