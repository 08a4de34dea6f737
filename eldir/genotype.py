"""Genotypes: which triangles a body fills and which springs may act (paper, Sect. Morphology).

The operators work on whole populations: `triangles` (N, B, A) and `springs` (N, S) bool.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import PlainSerializer, PlainValidator, WithJsonSchema

from eldir.core.arguments import require_whole_number
from eldir.core.records import BoolArray, IntArray, Record
from eldir.lattice import Lattice

_TEXT = {"type": "string", "pattern": "^[01]+$"}


def _bits(text: object) -> list[bool]:
    if not isinstance(text, str) or set(text) - {"0", "1"}:
        raise ValueError("expected characters 0 and 1")
    return [c == "1" for c in text]


def _rows(texts: object) -> list[list[bool]]:
    if not isinstance(texts, list):
        raise ValueError("expected a list of rows")
    return [_bits(text) for text in texts][::-1]


def _text(bits: BoolArray) -> str:
    return "".join("01"[int(b)] for b in bits)


_Mask = Annotated[
    BoolArray,
    PlainValidator(_rows),
    PlainSerializer(lambda mask: [_text(row) for row in mask[::-1]]),
    WithJsonSchema({"type": "array", "items": _TEXT, "minItems": 1}),
]
_Bits = Annotated[BoolArray, PlainValidator(_bits), PlainSerializer(_text), WithJsonSchema(_TEXT)]


@dataclass(frozen=True, eq=False)
class Genotype(Record):
    """Genotype of one robot: the filled triangles and the active springs, which evolution varies."""

    triangles: _Mask
    """Filled triangles, shape (rows, columns); row 0 is the bottom. In files a text of 0 and 1 for each row,
    the top row first."""
    springs: _Bits
    """Whether each lattice spring acts where it is expressed, shape (lattice springs,). In files a text of 0
    and 1."""

    def __post_init__(self) -> None:
        self._set_array("triangles", bool, (None, None))
        self._set_array("springs", bool, (None,))


def random_genotypes(
    lattice: Lattice, n: int, rng: np.random.Generator, max_active: int | None = None
) -> list[Genotype]:
    """`n` repaired genotypes, every triangle and spring bit set with probability 1/2.

    `max_active` bounds the active springs of the expressed body (two for building). Raises `InputError` for
    `n` or `max_active` below 1.
    """
    require_whole_number("n", n, 1)
    triangles = rng.random((n, lattice.rows, lattice.columns)) < 0.5
    while (empty := ~triangles.any(axis=(1, 2))).any():  # happens on tiny lattices
        triangles[empty] = rng.random((int(empty.sum()), lattice.rows, lattice.columns)) < 0.5
    springs = rng.random((n, len(lattice.springs))) < 0.5
    bodies = repair_bodies(lattice, triangles)
    return unstack(bodies, repair_springs(lattice, bodies, springs, rng, max_active))


def fill(lattice: Lattice, triangles: BoolArray) -> BoolArray:
    """Add every triangle whose three springs exist already."""
    springs = lattice.expressed_springs(triangles)
    enclosed = springs[..., lattice.triangle_springs].all(axis=-1)
    return triangles | enclosed.reshape(triangles.shape)


def largest_component(triangles: BoolArray) -> BoolArray:
    """Keep the largest connected part of every mask; of equal ones, the first from the bottom."""
    mask, run, part = _runs(triangles)
    part_of_triangle = part[run[triangles]]
    sizes = np.bincount(part_of_triangle, minlength=len(part))  # of each part, at its first run
    first = np.flatnonzero(np.diff(mask, prepend=-1))
    largest = np.repeat(np.maximum.reduceat(sizes, first), np.diff(first, append=len(mask)))
    winners = np.flatnonzero(sizes == largest)
    kept = np.zeros(len(part), bool)
    kept[winners[np.diff(mask[winners], prepend=-1) > 0]] = True
    found = triangles.copy()
    found[triangles] = kept[part_of_triangle]
    return found


def repair_bodies(lattice: Lattice, triangles: BoolArray) -> BoolArray:
    """Fill, then keep the largest component; applying it twice changes nothing."""
    return largest_component(fill(lattice, triangles))


def repair_springs(
    lattice: Lattice,
    triangles: BoolArray,
    springs: BoolArray,
    rng: np.random.Generator,
    max_active: int | None = None,
) -> BoolArray:
    """Leave between one and `max_active` active springs in every expressed body.

    If there are more, a random choice of `max_active` stays active. If there is none, a random one becomes
    active. Bits of springs that the body does not have stay as they are.
    """
    if max_active is not None:
        require_whole_number("max_active", max_active, 1)
    expressed = lattice.expressed_springs(triangles)
    active = springs & expressed
    count = active.sum(axis=1)
    wanted = np.maximum(count, 1)
    if max_active is not None:
        wanted = np.minimum(wanted, max_active)
    wrong = np.flatnonzero(wanted != count)
    repaired = springs.copy()
    for i in wrong:
        pool = np.flatnonzero(active[i] if count[i] else expressed[i])
        repaired[i] &= ~expressed[i]
        repaired[i, rng.choice(pool, wanted[i], replace=False)] = True
    return repaired


def stack(genotypes: Sequence[Genotype]) -> tuple[BoolArray, BoolArray]:
    """A population as two arrays: triangles (N, B, A) and springs (N, S)."""
    return np.stack([g.triangles for g in genotypes]), np.stack([g.springs for g in genotypes])


def unstack(triangles: BoolArray, springs: BoolArray) -> list[Genotype]:
    """The inverse of `stack`."""
    # Copies: one genotype that survives must not keep the arrays of all.
    return [Genotype.construct(t.copy(), s.copy()) for t, s in zip(triangles, springs, strict=True)]


def component_count(triangles: BoolArray) -> IntArray:
    """Number of connected parts of every mask, shape (N,)."""
    mask, _, part = _runs(triangles)
    return np.bincount(mask[part == np.arange(len(part))], minlength=len(triangles))


def _runs(triangles: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """The runs of filled triangles in the rows of all masks, numbered from the first mask's bottom on: the
    mask of each run, the run of each filled triangle, and the first run to which each run is connected.

    Neighbours are beside, above and below. Two triangles above each other share either an edge or only a
    vertex; the second kind is a hinge, and the paper counts it as connected.
    """
    begins = triangles.copy()
    begins[..., 1:] &= ~triangles[..., :-1]
    run = np.cumsum(begins, dtype=np.int32).reshape(begins.shape) - 1
    touching = triangles[:, 1:] & triangles[:, :-1] & (begins[:, 1:] | begins[:, :-1])  # once for two runs
    one, other = run[:, 1:][touching], run[:, :-1][touching]
    part = np.arange(np.count_nonzero(begins), dtype=np.int32)
    # Plain arrays: `scipy.ndimage` would take a third of every command's start.
    while len(one):
        part[np.maximum(one, other)] = np.minimum(one, other)
        while not np.array_equal(part, further := part[part]):
            part = further
        one, other = part[one], part[other]
        apart = one != other
        one, other = one[apart], other[apart]
    return np.nonzero(begins)[0], run, part
