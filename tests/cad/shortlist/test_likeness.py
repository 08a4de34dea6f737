"""How alike bodies are, against counting springs by hand and against what must hold for any bodies."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.evolution.printed.genome import mirror_genome
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir_cad.shortlist.ranking import MAX_SIMILARITY, diverse_first, repeats_last, spring_overlap
from tests.eldir.evolution.printed.small_searches import SMALL, edges, genomes

LATTICE = Lattice(2, 9)
BODIES = [genome.body(SMALL.lattice) for genome in genomes(12, seed=5)]


def bar(*triangles: int, row: int = 0) -> Morphology:
    """The triangles of one row, counted from the left."""
    shape = np.zeros((2, 9), bool)
    shape[row, list(triangles)] = True
    return develop(LATTICE, Genotype(shape, np.zeros(len(LATTICE.springs), bool)))


def test_springs_in_common_are_counted_once() -> None:
    """Two triangles have five springs, three have seven: five in common."""
    assert spring_overlap(bar(0, 1), bar(0, 1, 2)) == pytest.approx(5 / 7)
    assert spring_overlap(bar(0, 1), bar(0, 1)) == 1.0


def test_a_body_is_like_itself_anywhere_on_the_ground() -> None:
    assert spring_overlap(bar(0, 1, 2), bar(4, 5, 6)) == 1.0
    assert spring_overlap(bar(1, 2), bar(6, 7, 8)) == spring_overlap(bar(1, 2), bar(0, 1, 2))


def test_neighbouring_triangles_point_either_way_and_differ() -> None:
    assert spring_overlap(bar(0), bar(1)) < 1.0
    assert spring_overlap(bar(0), bar(2)) == 1.0


def test_a_mirror_image_has_all_springs_in_common() -> None:
    """The middles of its springs are on the same grid for even and odd lengths."""
    for genome, body in zip(genomes(12, seed=5), BODIES, strict=True):
        assert spring_overlap(body, mirror_genome(SMALL.lattice, genome).body(SMALL.lattice)) == 1.0


def test_a_body_that_is_there_already_comes_after_others_that_are_good() -> None:
    names = ["first", "the same", "other", "bad", "again bad"]
    bodies = [bar(0, 1, 2), bar(4, 5, 6), bar(0, 1), bar(0), bar(0, 1, 2, 3)]
    good = [True, True, True, False, False]
    assert repeats_last(names, bodies, good) == ["first", "other", "the same", "bad", "again bad"]
    assert repeats_last(names, bodies, [False, True, True, True, True])[:3] == ["other", "bad", "again bad"]
    assert repeats_last([], [], []) == []


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(BODIES), st.sampled_from(BODIES))
def test_likeness_goes_both_ways_and_is_whole_for_equal_bodies_alone(
    one: Morphology, other: Morphology
) -> None:
    share = spring_overlap(one, other)
    assert share == spring_overlap(other, one) and 0.0 <= share <= 1.0
    assert spring_overlap(one, one) == 1.0
    assert (share == 1.0) == any(edges(one).keys() == edges(other, turn).keys() for turn in (1.0, -1.0))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(range(len(BODIES))), max_size=8), st.sampled_from([0.2, 0.5, MAX_SIMILARITY]))
def test_the_first_of_those_that_are_alike_comes_first(chosen: list[int], alike: float) -> None:
    bodies = [BODIES[k] for k in chosen]
    order = diverse_first(bodies, alike)
    assert sorted(order) == list(range(len(bodies)))
    first: list[int] = []
    for k in range(len(bodies)):
        if all(spring_overlap(bodies[k], bodies[f]) <= alike for f in first):
            first.append(k)
    assert order[: len(first)] == first
    assert order[len(first) :] == sorted(order[len(first) :])
    assert diverse_first(bodies, alike, [True] * len(bodies)) == sorted(order)
