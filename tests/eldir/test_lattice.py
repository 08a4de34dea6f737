"""The lattice and development against the numbers and the golden bodies of the released code."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from eldir.errors import InputError
from eldir.genotype import (
    Genotype,
    component_count,
    fill,
    largest_component,
    random_genotypes,
    repair_bodies,
    stack,
)
from eldir.lattice import Lattice
from eldir.morphology import develop, develop_all
from tests.paths import DATA
from tests.raised import raises

GOLDEN = sorted((DATA).glob("*_small_s1.npz"))


def test_sizes_of_the_papers_lattices():
    paper, build = Lattice(13, 22), Lattice(6, 11)
    assert paper.vertices.shape == (168, 2)
    assert paper.springs.shape == (453, 2)
    assert paper.triangles.shape == (286, 3)
    assert (len(build.vertices), len(build.springs)) == (45, 110)


def test_every_triangle_is_equilateral_and_every_spring_has_its_rest_length():
    lattice = Lattice(5, 8)
    positions = lattice.positions(np.arange(len(lattice.vertices)), np.array([0]))
    sides = positions[lattice.springs[:, 0]] - positions[lattice.springs[:, 1]]
    np.testing.assert_allclose(np.hypot(*sides.T), 0.05, rtol=1e-12)
    assert (lattice.springs[lattice.triangle_springs].reshape(-1, 6).max(axis=1)
            == lattice.triangles.max(axis=1)).all()  # fmt: skip


@pytest.mark.parametrize("path", GOLDEN, ids=lambda p: p.stem)
def test_golden_bodies(path):
    golden = np.load(path)
    lattice = Lattice(6, 11)
    np.testing.assert_array_equal(lattice.vertices, golden["lattice_nodes"])
    np.testing.assert_array_equal(lattice.springs, golden["lattice_springs"])
    body = repair_bodies(lattice, golden["raw_body"][None].astype(bool))[0]
    np.testing.assert_array_equal(body, golden["body_mask"].astype(bool))
    robot = develop(lattice, Genotype(body, golden["spring_geno"].astype(bool)))
    np.testing.assert_allclose(robot.positions, golden["points"], atol=1e-15)
    np.testing.assert_array_equal(robot.springs, golden["springs"][:, :2])
    np.testing.assert_array_equal(robot.rest_lengths, golden["springs"][:, 2])
    np.testing.assert_array_equal(robot.active, golden["springs"][:, 4] > 0)


def test_random_bodies_have_the_papers_sizes():
    lattice = Lattice(13, 22)
    triangles, springs = stack(random_genotypes(lattice, 3000, np.random.default_rng(7)))
    expressed = lattice.expressed_springs(triangles)
    count = expressed.sum(axis=1)
    assert abs(count.mean() - 176) <= 4
    assert abs(count.std() - 68) <= 4
    assert abs((springs & expressed).sum() / expressed.sum() - 0.49) < 0.02


def test_largest_component_against_a_graph_library():
    """Four-connected neighbours in the mask, built as a graph and searched by scipy."""
    rng = np.random.default_rng(3)
    masks = rng.random((50, 6, 9)) < 0.5
    kept = largest_component(masks)
    numbers = np.arange(54).reshape(6, 9)
    beside = np.concatenate(
        [
            np.stack([numbers[:, :-1].ravel(), numbers[:, 1:].ravel()], 1),
            np.stack([numbers[:-1].ravel(), numbers[1:].ravel()], 1),
        ]
    )
    parts = component_count(masks)
    for mask, body, count in zip(masks, kept, parts, strict=True):
        on = mask.ravel()
        both = beside[on[beside].all(axis=1)]
        graph = coo_array((np.ones(len(both)), both.T), shape=(54, 54))
        _, label = connected_components(graph, directed=False)
        sizes = np.bincount(label[on])
        assert count == (sizes > 0).sum()
        first = next(part for part in label[on] if sizes[part] == sizes.max())  # of equal ones
        assert (body.ravel() == (on & (label == first))).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 7), st.integers(1, 11), st.integers(0, 2**32 - 1), st.sampled_from([None, 1, 2, 5]))
def test_random_genotypes_are_always_sound(rows, columns, seed, max_active):
    lattice = Lattice(rows, columns)
    for genotype in random_genotypes(lattice, 5, np.random.default_rng(seed), max_active):
        robot = develop(lattice, genotype)  # raises on an unfilled or disconnected body
        assert 1 <= robot.motors <= (max_active or len(robot.springs))
        again = repair_bodies(lattice, genotype.triangles[None])[0]
        np.testing.assert_array_equal(again, genotype.triangles)
        assert robot.positions.min(axis=0) == pytest.approx([0.025, 0.1])
        assert (np.diff(robot.springs @ [len(robot.positions), 1]) > 0).all()  # lexicographic


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 13), st.integers(1, 22), st.integers(1, 7), st.integers(0, 2**32 - 1))
def test_bodies_are_their_triangles_sides(rows, columns, n, seed):
    """Many genotypes at once, against sets of corners and sides, triangle by triangle."""
    lattice = Lattice(rows, columns)
    genotypes = random_genotypes(lattice, n, np.random.default_rng(seed))
    bodies = develop_all(lattice, genotypes)
    assert bodies == [develop(lattice, g) for g in genotypes]
    for genotype, body in zip(genotypes, bodies, strict=True):
        filled = lattice.triangles[genotype.triangles.ravel()].tolist()
        corners = sorted({v for triangle in filled for v in triangle})
        sides = sorted({(t[i], t[j]) for t in filled for i, j in ((0, 1), (0, 2), (1, 2))})
        assert body.vertices.tolist() == corners
        assert lattice.springs[body.lattice_springs].tolist() == [list(side) for side in sides]
        assert body.springs.tolist() == [[corners.index(a), corners.index(b)] for a, b in sides]
        assert body.active.tolist() == genotype.springs[body.lattice_springs].tolist()
        assert (body.rest_lengths == 0.05).all()
        at = lattice.vertices[corners] * [0.025, 0.025 * 3**0.5]
        np.testing.assert_allclose(body.positions, at - at.min(axis=0) + [0.025, 0.1], rtol=0, atol=1e-15)
        arrays = (getattr(body, f.name) for f in fields(body))
        assert not any(array.flags.writeable for array in arrays)


def test_the_same_seed_gives_the_same_genotypes():
    lattice = Lattice(6, 11)
    one, two = (random_genotypes(lattice, 20, np.random.default_rng(5), 2) for _ in range(2))
    assert one == two


def test_unsound_bodies_are_refused():
    lattice = Lattice(4, 6)
    springs = np.ones(len(lattice.springs), bool)
    apart = np.zeros((4, 6), bool)
    apart[0, 0] = apart[3, 5] = True
    with raises(InputError, "body.in-pieces"):
        develop(lattice, Genotype(apart, springs))
    with raises(InputError, "body.in-pieces"):
        develop(lattice, Genotype(np.zeros((4, 6), bool), springs))
    with raises(InputError, "input.wrong-shape", "triangles"):
        develop(Lattice(4, 7), Genotype(apart, springs))
    ring = np.ones((4, 6), bool)
    ring[1, 2] = False  # enclosed by its three neighbours
    assert fill(lattice, ring[None])[0].all()
    with raises(InputError, "body.empty-triangle"):
        develop(lattice, Genotype(ring, springs))
