"""How alike bodies are: the share of springs that two of them have in common."""

from __future__ import annotations

from collections.abc import Sequence

from eldir.lattice import HALF_SIDE
from eldir.morphology import Morphology

ALIKE = 0.8
"""Two bodies that share more than this are alike."""
_GRID = 4  # steps in half a side of a triangle: middles of springs lie on them, masses on every fourth


def shared_springs(one: Morphology, other: Morphology) -> float:
    """Springs that two bodies have in common when they stand best on each other, as a share of all springs
    of both, 0 to 1. Bodies stand on the ground and may be shifted along it, not turned round."""
    a, b = _places(one), _places(other)
    longest = max(x for x, _ in a | b) // _GRID
    steps = range(-longest * _GRID, longest * _GRID + 1, _GRID)
    return max(_share(a, {(x + step, z) for x, z in b}) for step in steps)


def unlike_first(bodies: Sequence[Morphology], alike: float = ALIKE) -> list[int]:
    """Indices of the bodies that share at most `alike` with each one chosen before; then those of the others.
    Both in their order."""
    chosen: list[int] = []
    for i, body in enumerate(bodies):
        if all(shared_springs(body, bodies[k]) <= alike for k in chosen):
            chosen.append(i)
    return chosen + [i for i in range(len(bodies)) if i not in set(chosen)]


def _places(body: Morphology) -> set[tuple[int, int]]:
    """Middles of the springs on a grid, from the body's lower left corner."""
    middles = (body.positions[body.springs].mean(axis=1) - body.positions.min(axis=0)) / HALF_SIDE * _GRID
    return {(round(x), round(z)) for x, z in middles.tolist()}


def _share(a: set[tuple[int, int]], b: set[tuple[int, int]]) -> float:
    return len(a & b) / len(a | b)
