"""Running built robots as one batch: sort into groups of the same body, pack, call the kernel, unpack."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eldir.engine.aligned import aligned
from eldir.engine.built import motion_kernel
from eldir.engine.built.motion_kernel import LANES
from eldir.engine.pack import offsets
from eldir.engine.runtime import prefer, start, threads

FloatRows = NDArray[np.float64]


@dataclass(frozen=True)
class Member:
    """One robot and what it is to do; or the slopes of all this with respect to a parameter."""

    springs: NDArray[np.int32]
    """Active ones first, shape (S, 2)."""
    direction: FloatRows
    """From the second to the first mass of every spring at rest, of length 1, shape (S, 2)."""
    strips: FloatRows
    """Rest length, stiffness, buckling load, damping and bending stiffness, shape (5, S)."""
    per_mass: FloatRows
    """1 / mass [1/kg] and 1 / moment of inertia [1/(kg m2)], shape (2, M)."""
    properties: FloatRows
    """As `eldir.engine.built.motion_kernel.PROPERTIES` lists them."""
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


class Outcome(NamedTuple):
    """What became of one member."""

    positions: FloatRows
    """Shape (K // every + 1, M, 2)."""
    state: FloatRows
    """At the end, as `Member.state`."""
    blown: int
    """-1, or the interval in which it blew up."""
    slopes: tuple[FloatRows, FloatRows] | None = None
    """Of positions and state, where they were asked for."""


def run(members: Sequence[Member], every: int, slopes: Sequence[Member] | None = None) -> list[Outcome]:
    """Drive all members, in input order; what becomes of one does not depend on the others.

    With `slopes`, one for each member, follow also how the motion changes with the parameter that they
    belong to.
    """
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
        filled = [(g + g[:1] * LANES)[:LANES] for g in alike]
        results = _run(
            [[members[i] for i in g] for g in filled],
            [[slopes[i] for i in g] for g in filled] if slopes is not None else None,
            every,
        )
        for group, found in zip(alike, results, strict=True):
            outcomes |= dict(zip(group, found, strict=False))
    return [outcomes[i] for i in range(len(members))]


def _run(groups: list[list[Member]], slopes: list[list[Member]] | None, every: int) -> list[list[Outcome]]:
    first = [group[0] for group in groups]
    n, rows = len(groups), len(first[0].state)
    m = np.array([f.per_mass.shape[1] for f in first], np.int32)
    s = np.array([len(f.springs) for f in first], np.int32)
    a = np.array([f.lengths.shape[1] for f in first], np.int32)
    k = np.array([len(f.lengths) - 1 for f in first], np.int32)
    substeps = np.array([max(r.properties[4] for r in group) for group in groups], np.int32)
    samples = k // every + 1
    record_at, state_at = offsets(samples * 2 * m), offsets(rows * m)
    size = 3 * int(m.max())
    workers = min(threads(), n)
    status = aligned(n * LANES, np.int32)
    counts = (n, workers, size, every, aligned(1, np.int32), m, s, a, k, substeps)
    places = (offsets(m), offsets(s), offsets((k + 1) * a), record_at)
    ends = np.concatenate([f.springs.ravel() for f in first])
    direction = np.concatenate([f.direction.ravel() for f in first])
    properties, *values = _columns(groups)
    impulse, record = _zeros(size * workers), _zeros(int(record_at[-1]))
    sloped = slopes is not None
    properties_, *values_ = _columns(slopes) if slopes is not None else (properties, *values)
    impulse_, record_ = (_zeros(len(v)) for v in (impulse, record)) if sloped else (impulse, record)
    both = [column for pair in zip(values, values_, strict=True) for column in pair]
    prefer("f64")
    motion_kernel.build(rows > 4, sloped)(
        *counts, properties, properties_, *places, ends, direction, *both,
        impulse, impulse_, status, record, record_,
    )  # fmt: skip
    records, states = ([record, record_], [values[0], values_[0]]) if sloped else ([record], [values[0]])

    def outcome(g: int, j: int) -> Outcome:
        shape = (samples[g], 2, m[g])
        moved = [
            r[record_at[g] : record_at[g + 1], j].reshape(shape).transpose(0, 2, 1).copy() for r in records
        ]
        ended = [c[state_at[g] : state_at[g + 1], j].reshape(rows, m[g]).copy() for c in states]
        slope = (moved[1], ended[1]) if sloped else None
        return Outcome(moved[0], ended[0], int(status[LANES * g + j]), slope)

    return [[outcome(g, j) for j in range(LANES)] for g in range(n)]


def _columns(groups: list[list[Member]]) -> list[FloatRows]:
    """Properties, state, masses and inertias, strips, lengths and stiffnesses of all lanes."""
    return [
        _lanes(groups, lambda r: r.properties),
        _lanes(groups, lambda r: r.state),
        *(_lanes(groups, lambda r, i=i: r.per_mass[i]) for i in range(2)),
        *(_lanes(groups, lambda r, i=i: r.strips[i]) for i in range(5)),
        _lanes(groups, lambda r: r.lengths),
        _lanes(groups, lambda r: r.stiffnesses),
    ]


def _lanes(groups: list[list[Member]], of: Callable[[Member], FloatRows]) -> FloatRows:
    """A value of every robot, one group after the other, shape (values, LANES)."""
    columns = [np.stack([of(r).ravel() for r in group], axis=1) for group in groups]
    values = np.concatenate([*columns, np.zeros((1, LANES))])  # never empty
    lanes = _zeros(len(values))
    lanes[:] = values
    return lanes


def _zeros(rows: int) -> FloatRows:
    return aligned(rows * LANES, np.float64).reshape(-1, LANES)
