"""When two bodies are the same one: against sets of springs, shifted and mirrored by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.evolution.printed.genome import mirror_genome, shift_genome
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from tests.eldir.evolution.printed.small_searches import LATTICE, edges, genomes

GENOMES = genomes(40, seed=5)
SMALL = Lattice(1, 4)


def bar(*motors: int) -> Morphology:
    """Three triangles in a row, with seven springs."""
    mask = np.array([[True, True, True, False]])
    springs = np.zeros(len(SMALL.springs), bool)
    springs[np.flatnonzero(SMALL.expressed_springs(mask))[list(motors)]] = True
    return develop(SMALL, Genotype(mask, springs))


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(GENOMES), st.integers(-4, 4), st.integers(-2, 2))
def test_a_shift_and_a_mirror_image_are_the_same_body(genome, right, up) -> None:
    one = genome.body(LATTICE)
    moved = shift_genome(LATTICE, genome, right + (right + up) % 2, up) or genome
    for other in (moved.body(LATTICE), mirror_genome(LATTICE, moved).body(LATTICE)):
        assert other.body_key == one.body_key
        assert other.body_name == one.body_name


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(range(40)), st.sampled_from(range(40)))
def test_other_springs_or_motors_are_another_body(i, k) -> None:
    one, other = GENOMES[i].body(LATTICE), GENOMES[k].body(LATTICE)
    either = edges(other), edges(other, -1.0)
    assert (one.body_key == other.body_key) == (edges(one) in either)


@pytest.mark.parametrize(("motors", "same"), [((0, 1), True), ((5, 6), True), ((0, 2), False), ((0,), False)])
def test_a_motor_elsewhere_is_another_body(motors, same) -> None:
    """Springs are in the order of their masses from left to right: the last two mirror the first two."""
    one, other = bar(0, 1), bar(*motors)
    assert (one.body_key == other.body_key) == same == (one.body_name == other.body_name)


def test_names_are_the_same_everywhere() -> None:
    """They are compared between runs of several machines."""
    assert bar(0, 1).body_name == bar(5, 6).body_name == "6e61a7fb"
