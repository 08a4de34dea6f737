"""Variation: how offspring come from progenitors (paper, Sect. Mutation and Sect. Crossover).

Operators work on whole populations: `triangles` (N, B, A) and `springs` (N, S) bool. They are
pure functions of their arguments and of the generator handed in. `inherit` gives offspring the part of a
parent's learned controller that fits.
"""

from __future__ import annotations

import numpy as np

from eldir.controller import CPGS, HIDDEN, Controller
from eldir.core.arguments import require_known
from eldir.core.records import BoolArray, IntArray
from eldir.defaults import Crossover
from eldir.genotype import Genotype, repair_bodies, repair_springs, stack, unstack
from eldir.lattice import Lattice
from eldir.morphology import Morphology

CROSSOVER_SHARE = 0.8
"""Share of the offspring that have two progenitors, where crossover is used; the others only mutate."""
_ZEROED = {"distinct": 0.35, "joint": 0.25}


def make_offspring(
    lattice: Lattice,
    progenitors: list[Genotype],
    rng: np.random.Generator,
    crossover: Crossover = "none",
    max_active: int | None = None,
) -> tuple[list[Genotype], IntArray]:
    """One mutated offspring for every progenitor, and the progenitors' indices, shape (N, 2).

    `crossover` is one of the direct encoding (`eldir.defaults.CROSSOVERS`). The two indices are equal
    where an offspring has a single parent. No offspring's body equals the one that it was mutated from
    (except on a lattice of a single triangle).
    """
    require_known("crossover", crossover, ("none", *_ZEROED))
    triangles, springs = stack(progenitors)
    n = len(triangles)
    parents = np.repeat(np.arange(n, dtype=np.int32)[:, None], 2, axis=1)
    if crossover != "none" and n > 1:
        crossed = np.flatnonzero(rng.random(n) < CROSSOVER_SHARE)
        parents[crossed] = draw_pairs(n, len(crossed), rng)
        one, other = parents[crossed].T
        triangles[crossed] = cross_bodies(lattice, triangles[one], triangles[other], crossover, rng)
        springs[crossed] = cross_springs(springs[one], springs[other], rng)
    bodies = mutate_bodies(lattice, triangles, rng)
    return unstack(bodies, mutate_springs(lattice, bodies, springs, rng, max_active)), parents


def mutate_bodies(lattice: Lattice, triangles: BoolArray, rng: np.random.Generator) -> BoolArray:
    """Flip each bit with p = 1/n and repair; unchanged or empty bodies again from the parent with
    twice the probability, until every one differs from its parent."""
    if triangles[0].size == 1:
        return triangles.copy()  # the only body of this lattice
    bits = triangles[0].size
    mutated = triangles.copy()
    same = np.arange(len(triangles))
    p = 1.0 / bits
    while len(same):
        flipped = flip_bits(triangles[same], p, rng)
        mutated[same] = repair_bodies(lattice, flipped)
        unchanged = (mutated[same] == triangles[same]).all(axis=(1, 2))
        empty = ~mutated[same].any(axis=(1, 2))
        same = same[unchanged | empty]
        p = min(2.0 * p, 0.5)  # beyond one half a mask would turn into its negative
    return mutated


def mutate_springs(
    lattice: Lattice,
    triangles: BoolArray,
    springs: BoolArray,
    rng: np.random.Generator,
    max_active: int | None = None,
) -> BoolArray:
    """Flip each bit once with p = 1/(lattice springs); `triangles` are the bodies that carry them."""
    flipped = flip_bits(springs, 1.0 / springs.shape[1], rng)
    return repair_springs(lattice, triangles, flipped, rng, max_active)


def flip_bits(mask: BoolArray, p: float, rng: np.random.Generator) -> BoolArray:
    """A mask in which each bit is flipped with probability p."""
    return mask ^ (rng.random(mask.shape) < p)


def cross_springs(one: BoolArray, other: BoolArray, rng: np.random.Generator) -> BoolArray:
    """Springs of offspring: every bit from either progenitor with equal probability, shapes (N, S)."""
    return np.where(rng.random(one.shape) < 0.5, one, other)


def cross_bodies(
    lattice: Lattice,
    one: BoolArray,
    other: BoolArray,
    method: Crossover,
    rng: np.random.Generator,
) -> BoolArray:
    """Bodies of offspring: masks of both progenitors aligned, thinned and united, shapes (N, B, A), then
    repaired.

    'distinct' zeroes an expected 35 % of each mask before the union, 'joint' 25 % of the union.
    """
    one, other = align(one, other, rng)
    crossed = np.zeros_like(one)
    empty = np.arange(len(one))
    share = _ZEROED[method]
    while len(empty):
        a, b = one[empty], other[empty]
        if method == "distinct":
            united = _thin(a, share, rng) | _thin(b, share, rng)
        else:
            united = _thin(a | b, share, rng)
        crossed[empty] = repair_bodies(lattice, united)
        empty = empty[~crossed[empty].any(axis=(1, 2))]
    return crossed


def align(one: BoolArray, other: BoolArray, rng: np.random.Generator) -> tuple[BoolArray, BoolArray]:
    """Shift, in x and in y, the mask with the narrower bounding box to a random place inside the
    extent of the wider one, so that a union holds pieces of both.

    The mask is shifted, not the drawn body: a shift by an odd number turns a triangle upside down.
    """
    one, other = one.copy(), other.copy()
    for axis in (1, 2):
        first_1, last_1 = _extent(one, axis)
        first_2, last_2 = _extent(other, axis)
        room = (last_2 - first_2) - (last_1 - first_1)  # > 0: `one` is the narrower
        place = rng.integers(0, np.abs(room) + 1)
        _shift(one, np.where(room > 0, first_2 + place - first_1, 0), axis)
        _shift(other, np.where(room <= 0, first_1 + place - first_2, 0), axis)
    return one, other


def _thin(mask: BoolArray, share: float, rng: np.random.Generator) -> BoolArray:
    return mask & (rng.random(mask.shape) >= share)


def _extent(masks: BoolArray, axis: int) -> tuple[IntArray, IntArray]:
    """First and last occupied row (axis 1) or column (axis 2) of every mask."""
    occupied: BoolArray = np.any(masks, axis=3 - axis)
    return occupied.argmax(axis=1), occupied.shape[1] - 1 - occupied[:, ::-1].argmax(axis=1)


def _shift(masks: BoolArray, by: IntArray, axis: int) -> None:
    """Move every mask by its own number of rows or columns; nothing occupied leaves the lattice."""
    source = (np.arange(masks.shape[axis]) - by[:, None]) % masks.shape[axis]
    masks[:] = np.take_along_axis(masks, np.expand_dims(source, 3 - axis), axis)


def draw_pairs(n: int, count: int, rng: np.random.Generator) -> IntArray:
    """Pairs of different progenitors for `count` offspring; each pair has two offspring."""
    drawn = (count + 1) // 2
    one = rng.integers(0, n, drawn)
    other = (one + rng.integers(1, n, drawn)) % n
    return np.repeat(np.stack([one, other], axis=1), 2, axis=0)[:count].astype(np.int32)


def inherit(parent: Morphology, trained: Controller, child: Morphology, fresh: Controller) -> Controller:
    """A controller for `child` with the parent's weights of all masses and motors that both have at the same
    place of the lattice, and all other weights as in `fresh`.

    The paper's robots learn from nothing; it lists weights passed on from parent to offspring among what may
    help.
    """
    w1 = fresh.w1.copy()
    w1[:, :CPGS] = trained.w1[:, :CPGS]
    _, old, new = np.intersect1d(parent.vertices, child.vertices, return_indices=True)
    sensed = w1[:, CPGS:].reshape(HIDDEN, -1, 4)  # a view: dx, dy, vx, vy of each mass
    sensed[:, new] = trained.w1[:, CPGS:].reshape(HIDDEN, -1, 4)[:, old]
    w2, b2 = fresh.w2.copy(), fresh.b2.copy()
    theirs, ours = (m.lattice_springs[m.active] for m in (parent, child))
    _, old, new = np.intersect1d(theirs, ours, return_indices=True)
    w2[new], b2[new] = trained.w2[old], trained.b2[old]
    return Controller(w1, trained.b1, w2, b2)
