"""Offspring of printed robots: always a body, always motors, and every kind of change happens."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eldir.evolution.printed.genome import motors_of
from eldir.evolution.printed.variation import offspring, random_genomes
from eldir.lattice import Lattice
from tests.evolution.printed.small import LATTICE, genomes


@given(rows=st.integers(1, 5), columns=st.integers(1, 8), motors=st.integers(1, 3), seed=st.integers(0, 999))
def test_offspring_are_whole_robots_and_differ_from_their_parent(
    rows: int, columns: int, motors: int, seed: int
) -> None:
    lattice, rng = Lattice(rows, columns), np.random.default_rng(seed)
    for parent in random_genomes(lattice, 2, rng, motors, 3):
        child = offspring(lattice, parent, rng, motors, 3)
        for one in (parent, child):
            body = one.body(lattice)  # refuses what is not in one piece
            assert 1 <= body.motors <= motors
            assert ((one.phases >= 0) & (one.phases < 1)).all() and 0 <= one.timing < 3
            gait = one.gait(body, [(20.0, 6.0)] * 3)
            assert len(gait.phase) == body.motors and gait.phase[0] == 0
        if lattice.rows * lattice.columns > 1:
            assert child != parent


def test_every_gene_changes_and_one_kind_at_a_time() -> None:
    rng, (parent,) = np.random.default_rng(1), genomes(1, 5)
    body = parent.body(LATTICE)
    seen = set()
    for _ in range(300):
        child = offspring(LATTICE, parent, rng, 2, 3)
        other = child.body(LATTICE)
        bodies = not np.array_equal(child.genotype.triangles, parent.genotype.triangles)
        motors = not bodies and not np.array_equal(motors_of(other), motors_of(body))
        phases = not bodies and not motors and not np.array_equal(child.phases, parent.phases)
        if motors and other.motors == body.motors:
            gone, come = (
                set(motors_of(body)) - set(motors_of(other)),
                set(motors_of(other)) - set(motors_of(body)),
            )
            if len(gone) == len(come) == 1:
                kept = child.phases[come.pop()] == parent.phases[gone.pop()]
                seen.add(("moved motor", bool(kept)))
        seen.add((bodies, motors, phases, other.motors != body.motors, child.timing != parent.timing))
        if child.timing != parent.timing:
            assert phases, "another period comes with other phases"
    assert ("moved motor", True) in seen
    assert {(True, False, False), (False, True, False), (False, False, True)} <= {
        s[:3] for s in seen if len(s) == 5
    }
    assert any(len(s) == 5 and s[3] for s in seen) and any(len(s) == 5 and s[4] for s in seen)


def test_random_robots_are_neither_triangles_nor_as_large_as_the_lattice() -> None:
    """Half of a random window, a quarter to a half of the lattice either way: what walks is of that size."""
    lattice = Lattice(6, 11)
    drawn = genomes(300, 2, lattice)
    sizes = [len(g.body(lattice).springs) for g in drawn]
    assert np.quantile(sizes, 0.25) > 5 and np.quantile(sizes, 0.75) < 25 and len(set(sizes)) > 15
    places = np.array([g.genotype.triangles for g in drawn]).mean(axis=0)
    assert places.min() > 0, "some body fills every place of the lattice"
    for genome in drawn:
        rows, columns = np.nonzero(genome.genotype.triangles)
        assert np.ptp(rows) < 3 and np.ptp(columns) < 6
