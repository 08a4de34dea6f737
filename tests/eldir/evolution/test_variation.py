"""Offspring are whole, differ from their parents and keep the bound on motors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.errors import InputError
from eldir.evolution.variation import (
    align,
    cross_bodies,
    cross_springs,
    make_offspring,
    mutate_bodies,
    mutate_springs,
)
from eldir.genotype import component_count, random_genotypes, repair_bodies, repair_springs, stack
from eldir.lattice import Lattice
from eldir.morphology import develop
from tests.raised import raises

SMALL = st.builds(Lattice, st.integers(1, 7), st.integers(2, 9))
SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=25, deadline=None)
@given(SMALL, SEEDS)
def test_repair_is_idempotent(lattice, seed):
    rng = np.random.default_rng(seed)
    triangles, springs = stack(random_genotypes(lattice, 4, rng, max_active=2))
    assert np.array_equal(repair_bodies(lattice, triangles), triangles)
    assert np.array_equal(repair_springs(lattice, triangles, springs, rng, 2), springs)


@settings(max_examples=60, deadline=None)
@given(SMALL, SEEDS, st.sampled_from(["none", "distinct", "joint"]), st.sampled_from([None, 1, 2, 5]))
def test_offspring_can_be_built(lattice, seed, crossover, max_active):
    rng = np.random.default_rng(seed)
    progenitors = random_genotypes(lattice, 6, rng, max_active)
    before = [(g.triangles.copy(), g.springs.copy()) for g in progenitors]
    children, parents = make_offspring(lattice, progenitors, rng, crossover, max_active)
    assert len(children) == 6
    for child, (one, other) in zip(children, parents, strict=True):
        robot = develop(lattice, child)  # raises where unfilled, empty or in pieces
        assert 1 <= robot.motors <= (max_active or len(robot.springs))
        if one == other:
            assert not np.array_equal(child.triangles, progenitors[one].triangles)
    for g, (triangles, springs) in zip(progenitors, before, strict=True):
        assert np.array_equal(g.triangles, triangles)
        assert np.array_equal(g.springs, springs)


@settings(max_examples=30, deadline=None)
@given(SMALL, SEEDS, st.sampled_from(["distinct", "joint"]))
def test_crossed_bodies_are_whole(lattice, seed, method):
    rng = np.random.default_rng(seed)
    one, _ = stack(random_genotypes(lattice, 5, rng))
    other, _ = stack(random_genotypes(lattice, 5, rng))
    crossed = cross_bodies(lattice, one, other, method, rng)
    assert (component_count(crossed) == 1).all()
    assert np.array_equal(repair_bodies(lattice, crossed), crossed)


@settings(max_examples=30, deadline=None)
@given(SMALL, SEEDS)
def test_alignment_moves_the_narrower_inside_the_wider(lattice, seed):
    rng = np.random.default_rng(seed)
    one, _ = stack(random_genotypes(lattice, 5, rng))
    other, _ = stack(random_genotypes(lattice, 5, rng))
    for before, after in zip((one, other), align(one, other, rng), strict=True):
        assert np.array_equal(before.sum(axis=(1, 2)), after.sum(axis=(1, 2)))
    for a, b in zip(*align(one, other, rng), strict=True):
        for axis in (0, 1):
            spans = sorted(
                (np.flatnonzero(mask.any(axis=axis))[[0, -1]] for mask in (a, b)), key=lambda s: s[1] - s[0]
            )
            assert spans[1][0] <= spans[0][0]
            assert spans[0][1] <= spans[1][1]


def test_a_body_mutation_flips_about_one_bit():
    """With n bits at 1/n, given that something changed, few differ; measured before repair this is
    1 / (1 - 1/e) = 1.58; repair adds fills and drops severed parts."""
    lattice, rng = Lattice(), np.random.default_rng(3)
    triangles = np.ones((400, 13, 22), bool)
    changed = (mutate_bodies(lattice, triangles, rng) != triangles).sum(axis=(1, 2))
    # In a full body a removed inner triangle is filled again: only the rim can change at first.
    assert changed.min() >= 1
    assert np.median(changed) < 20


def test_spring_mutation_flips_one_bit_on_average():
    lattice, rng = Lattice(), np.random.default_rng(4)
    bodies = np.ones((2000, 13, 22), bool)
    springs = rng.random((2000, 453)) < 0.5
    flips = (mutate_springs(lattice, bodies, springs, rng) != springs).sum(axis=1)
    assert flips.mean() == pytest.approx(1.0, abs=4 / np.sqrt(2000))  # four standard errors


def test_springs_come_from_either_progenitor():
    rng = np.random.default_rng(5)
    one, other = np.zeros((50, 400), bool), np.ones((50, 400), bool)
    share = cross_springs(one, other, rng).mean()
    assert share == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(20000))
    assert np.array_equal(cross_springs(one, one, rng), one)


@pytest.mark.parametrize("method", ["distinct", "joint"])
def test_crossing_keeps_the_expected_share(method):
    """Full with full: distinct keeps 1 - 0.35^2 = 0.8775 of the bits, joint 0.75, before filling
    adds some and loose parts are lost; so distinct keeps more."""
    lattice, rng = Lattice(), np.random.default_rng(6)
    full = np.ones((200, 13, 22), bool)
    kept = cross_bodies(lattice, full, full, method, rng).mean()
    assert kept > {"distinct": 0.8775, "joint": 0.75}[method]
    assert kept < 0.999


def test_four_fifths_are_crossed_and_pairs_have_two_offspring():
    lattice, rng = Lattice(3, 4), np.random.default_rng(7)
    _, parents = make_offspring(lattice, random_genotypes(lattice, 1000, rng), rng, "joint")
    crossed = parents[parents[:, 0] != parents[:, 1]]
    assert len(crossed) / 1000 == pytest.approx(0.8, abs=4 * 0.4 / np.sqrt(1000))
    assert np.array_equal(crossed[0::2][: len(crossed) // 2], crossed[1::2])


def test_nobody_is_crossed_with_itself():
    """Among three, a partner drawn from all of them would be oneself every third time."""
    lattice, rng = Lattice(3, 4), np.random.default_rng(8)
    few = random_genotypes(lattice, 3, rng)
    parents = np.concatenate([make_offspring(lattice, few, rng, "distinct")[1] for _ in range(200)])
    share = (parents[:, 0] != parents[:, 1]).mean()
    assert share == pytest.approx(0.8, abs=4 * 0.4 / np.sqrt(600))


def test_the_same_generator_gives_the_same_offspring():
    lattice = Lattice()
    progenitors = random_genotypes(lattice, 20, np.random.default_rng(0))
    first = make_offspring(lattice, progenitors, np.random.default_rng(1), "distinct", 2)
    again = make_offspring(lattice, progenitors, np.random.default_rng(1), "distinct", 2)
    assert first[0] == again[0]
    assert np.array_equal(first[1], again[1])


def test_unknown_crossover_is_named():
    lattice, rng = Lattice(3, 4), np.random.default_rng(0)
    with raises(InputError, "input.unknown-name", "crossover"):
        make_offspring(lattice, random_genotypes(lattice, 2, rng), rng, "uniform")
