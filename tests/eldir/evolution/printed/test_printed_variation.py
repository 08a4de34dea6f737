"""Offspring of printed robots: always a body, always motors, and every kind of change happens."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldir.evolution.printed.genome import make_offspring, motor_springs, random_genomes
from eldir.lattice import Lattice
from tests.eldir.evolution.printed.small_searches import LATTICE, genomes


@given(rows=st.integers(1, 5), columns=st.integers(1, 8), motors=st.integers(1, 3), seed=st.integers(0, 999))
def test_offspring_are_whole_robots_and_differ_from_their_parent(
    rows: int, columns: int, motors: int, seed: int
) -> None:
    lattice, rng = Lattice(rows, columns), np.random.default_rng(seed)
    for parent in random_genomes(lattice, 2, rng, motors, 3):
        child = make_offspring(lattice, parent, rng, motors, 3)
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
        child = make_offspring(LATTICE, parent, rng, 2, 3)
        other = child.body(LATTICE)
        bodies = not np.array_equal(child.genotype.triangles, parent.genotype.triangles)
        motors = not bodies and not np.array_equal(motor_springs(other), motor_springs(body))
        phases = not bodies and not motors and not np.array_equal(child.phases, parent.phases)
        if motors and other.motors == body.motors:
            gone, come = (
                set(motor_springs(body)) - set(motor_springs(other)),
                set(motor_springs(other)) - set(motor_springs(body)),
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


def test_a_changed_gait_mostly_stays_on_its_peak_and_sometimes_tries_another_period() -> None:
    """The peak of a walk over the phase is about a tenth of a period wide; half of it is on either side."""
    rng, (parent,) = np.random.default_rng(2), genomes(1, 5)
    motors = motor_springs(parent.body(LATTICE))
    changes, others = [], []
    while len(changes) < 150:
        child = make_offspring(LATTICE, parent, rng, 2, 3)
        if child.genotype == parent.genotype:
            changes.append((child.phases[motors] - parent.phases[motors] + 0.5) % 1.0 - 0.5)
            others.append(child.timing != parent.timing)
    assert 0.02 < np.median(np.abs(changes)) < 0.1
    assert 0.1 < np.mean(others) < 0.4


@pytest.mark.parametrize("lattice", [Lattice(6, 11), Lattice(40, 60), Lattice(1, 2)])
def test_random_robots_are_of_the_size_that_walks_on_any_lattice(lattice: Lattice) -> None:
    """Half of a window of 2 to 3 by 3 to 6 triangles, wherever there is room."""
    shapes = []
    for genome in genomes(300, 2, lattice):
        rows, columns = np.nonzero(genome.genotype.triangles)
        shapes.append((np.ptp(rows) + 1, np.ptp(columns) + 1))
    assert np.max(shapes, axis=0).tolist() == [min(3, lattice.rows), min(6, lattice.columns)]


def test_random_robots_are_seldom_single_triangles_and_lie_anywhere() -> None:
    lattice = Lattice(6, 11)
    drawn = genomes(300, 2, lattice)
    sizes = [len(g.body(lattice).springs) for g in drawn]
    assert np.quantile(sizes, 0.25) > 5 and len(set(sizes)) > 15
    assert np.array([g.genotype.triangles for g in drawn]).any(axis=0).all()
