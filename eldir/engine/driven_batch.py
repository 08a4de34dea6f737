"""Running built robots as one batch: sort into groups of the same body, pack, call the kernel, unpack."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eldir.engine.driven import LANES, build
from eldir.engine.pack import offsets
from eldir.engine.runtime import aligned, start, threads

FloatRows = NDArray[np.float64]


@dataclass(frozen=True)
class Member:
    """One robot and what it is to do."""

    springs: NDArray[np.int32]
    """Active ones first, shape (S, 2)."""
    direction: FloatRows
    """From the second to the first mass of every spring at rest, of length 1, shape (S, 2)."""
    strips: FloatRows
    """Rest length, stiffness, buckling load, damping and bending stiffness, shape (5, S)."""
    masses: FloatRows
    """Mass [kg] and moment of inertia [kg m2], shape (2, M)."""
    properties: FloatRows
    """As `eldir.engine.driven.PROPERTIES` lists them."""
    lengths: FloatRows
    """Of the active springs at the ends of the intervals [m], shape (K + 1, A)."""
    stiffnesses: FloatRows
    """[N/m], shape (K + 1, A)."""
    state: FloatRows
    """x, y, vx, vy, and for clamped strips cosine, sine, spin, shape (4 or 7, M)."""

    @property
    def body(self) -> tuple[object, ...]:
        """What robots of one group share."""
        return (self.springs.tobytes(), self.direction.tobytes(), self.lengths.shape, self.state.shape)

    @property
    def work(self) -> float:
        """Springs times steps."""
        return float(len(self.springs) * len(self.lengths) * self.properties[4])


Outcome = tuple[FloatRows, FloatRows, int]
"""Positions (K // every + 1, M, 2), the final state, and -1 or the interval in which it blew up."""


def run(members: Sequence[Member], every: int) -> list[Outcome]:
    """Drive all members, in input order; what becomes of one does not depend on the others."""
    start()
    bodies: dict[tuple[object, ...], list[int]] = {}
    for i, member in enumerate(members):
        bodies.setdefault(member.body, []).append(i)
    groups = [same[i : i + LANES] for same in bodies.values() for i in range(0, len(same), LANES)]
    groups.sort(key=lambda group: -max(members[i].work for i in group))  # the longest first
    outcomes: dict[int, Outcome] = {}
    for rows in sorted({len(m.state) for m in members}):
        alike = [g for g in groups if len(members[g[0]].state) == rows]
        # Lanes that nobody needs repeat the group's first robot.
        filled = [[members[i] for i in (g + g[:1] * LANES)[:LANES]] for g in alike]
        for group, results in zip(alike, _run(filled, every), strict=True):
            outcomes |= dict(zip(group, results, strict=False))
    return [outcomes[i] for i in range(len(members))]


def _run(groups: list[list[Member]], every: int) -> list[list[Outcome]]:
    first = [group[0] for group in groups]
    n, rows = len(groups), len(first[0].state)
    m = np.array([f.masses.shape[1] for f in first], np.int32)
    s = np.array([len(f.springs) for f in first], np.int32)
    a = np.array([f.lengths.shape[1] for f in first], np.int32)
    k = np.array([len(f.lengths) - 1 for f in first], np.int32)
    substeps = np.array([max(r.properties[4] for r in group) for group in groups], np.int32)
    samples = k // every + 1
    record_at = offsets(samples * 2 * m)
    state = _lanes(groups, lambda r: r.state)
    per_mass, per_inertia = (_lanes(groups, lambda r, i=i: 1.0 / r.masses[i]) for i in range(2))
    strips = [_lanes(groups, lambda r, i=i: r.strips[i]) for i in range(5)]
    tables = [_lanes(groups, lambda r: r.lengths), _lanes(groups, lambda r: r.stiffnesses)]
    properties = _lanes(groups, lambda r: r.properties)
    size = 3 * int(m.max())
    workers = min(threads(), n)
    status = aligned(n * LANES, np.int32)
    record = aligned(int(record_at[-1]) * LANES, np.float64).reshape(-1, LANES)
    build(rows > 4)(
        n, workers, size, every, aligned(1, np.int32), m, s, a, k, substeps, properties,
        offsets(m), offsets(s), offsets((k + 1) * a), record_at, state, per_mass, per_inertia,
        np.concatenate([f.springs.ravel() for f in first]),
        np.concatenate([f.direction.ravel() for f in first]),
        *strips, *tables, aligned(size * workers * LANES, np.float64).reshape(-1, LANES), status, record,
    )  # fmt: skip
    state_at = offsets(rows * m)
    outcomes = []
    for g in range(n):
        moved = record[record_at[g] : record_at[g + 1]].reshape(samples[g], 2, m[g], LANES)
        ends = state[state_at[g] : state_at[g + 1]].reshape(rows, m[g], LANES)
        outcomes.append(
            [
                (moved[..., j].transpose(0, 2, 1).copy(), ends[..., j].copy(), int(status[LANES * g + j]))
                for j in range(LANES)
            ]
        )
    return outcomes


def _lanes(groups: list[list[Member]], of: Callable[[Member], FloatRows]) -> FloatRows:
    """A value of every robot, one group after the other, shape (values, LANES)."""
    columns = [np.stack([of(r).ravel() for r in group], axis=1) for group in groups]
    values = np.concatenate([*columns, np.zeros((1, LANES))])  # never empty
    lanes = aligned(values.size, np.float64).reshape(-1, LANES)
    lanes[:] = values
    return lanes
