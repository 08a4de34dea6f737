"""Moving printed robots as one batch: sort into groups of the same body, pack, launch the kernel, unpack."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir.engine.aligned import aligned
from eldir.engine.built.motion_kernel import motion_kernel
from eldir.engine.built.motion_launch import LANES, RECORDED, STEPS, LaneArrays, MotionLaunch
from eldir.engine.runtime import prefer, start
from eldir.engine.threads import worker_threads
from eldir.morphology import offsets
from eldir.parameters.printed import Joints


@dataclass(frozen=True)
class Member:
    """One robot and its commands; or the slopes of all these values with respect to a parameter."""

    springs: IntArray
    """Active ones first, shape (S, 2)."""
    direction: FloatArray
    """Unit vector from the second to the first mass of every spring at rest, shape (S, 2)."""
    strips: FloatArray
    """Rest length, stiffness, buckling load, damping and bending stiffness, shape (5, S)."""
    per_mass: FloatArray
    """1 / mass [1/kg], 1 / moment of inertia [1/(kg m2)] and coefficient of friction, shape (3, M)."""
    properties: FloatArray
    """The values that `eldir.engine.built.motion_launch.PROPERTIES` lists."""
    lengths: FloatArray
    """Free lengths of the active springs at the ends of the intervals [m], shape (K + 1, A)."""
    stiffnesses: FloatArray
    """Their stiffness [N/m], shape (K + 1, A)."""
    state: FloatArray
    """x, y, vx, vy, and unless strips are pinned cosine, sine, spin, shape (4 or 7, M)."""
    joints: Joints
    bristles: FloatArray
    """Of hubs: angle at which each socket's friction is without force [rad], shape (S, 2)."""

    @property
    def body(self) -> tuple[object, ...]:
        """Key of a group: robots with the same key move side by side."""
        return (self.springs.tobytes(), self.direction.tobytes(), self.lengths.shape, self.joints)

    @property
    def work(self) -> float:
        """Springs times steps."""
        return float(len(self.springs) * len(self.lengths) * self.properties[STEPS])


class MotionResult(NamedTuple):
    """Motion of one member."""

    positions: FloatArray
    """Positions [m], shape (K // every + 1, M, 2)."""
    rotations: FloatArray
    """Cosine and sine of the hubs' rotations, shape (K // every + 1, M, 2); without hubs (..., 0)."""
    state: FloatArray
    """State at the end, laid out as `Member.state`."""
    blown: int
    """-1, or the interval in which it blew up."""
    slopes: tuple[FloatArray, FloatArray] | None = None
    """Slopes of positions and state, if they were requested."""


def run_motions(
    members: Sequence[Member], every: int, slopes: Sequence[Member] | None = None
) -> list[MotionResult]:
    """Moves all members; results are in input order, and no robot's result depends on the others.

    `slopes`, one for each member, are derivatives of its values with respect to a parameter. With them, the
    results contain the derivatives of the motion too.
    """
    start()
    bodies: dict[tuple[object, ...], list[int]] = {}
    for i, member in enumerate(members):
        bodies.setdefault(member.body, []).append(i)
    groups = [same[i : i + LANES] for same in bodies.values() for i in range(0, len(same), LANES)]
    groups.sort(key=lambda group: -max(members[i].work for i in group))  # the longest first
    outcomes: dict[int, MotionResult] = {}
    for joints in sorted({m.joints for m in members}):
        alike = [g for g in groups if members[g[0]].joints == joints]
        # Lanes that nobody needs repeat the group's first robot.
        filled = [(g + g[:1] * LANES)[:LANES] for g in alike]
        results = _run_groups(
            [[members[i] for i in g] for g in filled],
            [[slopes[i] for i in g] for g in filled] if slopes is not None else None,
            every,
        )
        for group, found in zip(alike, results, strict=True):
            outcomes |= dict(zip(group, found, strict=False))
    return [outcomes[i] for i in range(len(members))]


def _run_groups(
    groups: list[list[Member]], slopes: list[list[Member]] | None, every: int
) -> list[list[MotionResult]]:
    first = [group[0] for group in groups]
    n, rows = len(groups), len(first[0].state)
    m = np.array([f.per_mass.shape[1] for f in first], np.int32)
    s = np.array([len(f.springs) for f in first], np.int32)
    a = np.array([f.lengths.shape[1] for f in first], np.int32)
    k = np.array([len(f.lengths) - 1 for f in first], np.int32)
    substeps = np.array([max(r.properties[STEPS] for r in group) for group in groups], np.int32)
    samples = k // every + 1
    kept = RECORDED[first[0].joints]
    record_at, state_at = offsets(samples * kept * m), offsets(rows * m)
    size = 3 * int(m.max())
    workers = min(worker_threads(), n)
    values = _lane_arrays(groups, size * workers, int(record_at[-1]))
    sloped = slopes is not None
    changes = _lane_arrays(slopes, size * workers, int(record_at[-1])) if slopes is not None else values
    status = aligned(n * LANES, np.int32)
    prefer("f64")
    motion_kernel(first[0].joints, sloped)(
        MotionLaunch(
            groups=n, workers=workers, workspace=size, every=every, queue=aligned(1, np.int32),
            masses=m, springs=s, active=a, intervals=k, substeps=substeps,
            mass_at=offsets(m), spring_at=offsets(s), length_at=offsets((k + 1) * a), record_at=record_at,
            ends=np.concatenate([f.springs.ravel() for f in first]),
            direction=np.concatenate([f.direction.ravel() for f in first]),
            status=status, values=values, slopes=changes,
        )
    )  # fmt: skip
    arrays = [values, changes] if sloped else [values]

    def result(g: int, j: int) -> MotionResult:
        shape = (samples[g], kept, m[g])
        moved = [
            of.record[record_at[g] : record_at[g + 1], j].reshape(shape).transpose(0, 2, 1).copy()
            for of in arrays
        ]
        ended = [of.state[state_at[g] : state_at[g + 1], j].reshape(rows, m[g]).copy() for of in arrays]
        slope = (moved[1], ended[1]) if sloped else None
        x, rotations = moved[0][..., :2], moved[0][..., 2:]
        return MotionResult(x, rotations, ended[0], int(status[LANES * g + j]), slope)

    return [[result(g, j) for j in range(LANES)] for g in range(n)]


def _lane_arrays(groups: list[list[Member]], scratch: int, record: int) -> LaneArrays:
    """The values of all robots, or their slopes, with room for impulses and for what is recorded."""
    rest_length, stiffness, buckling, damping, bending = (
        _lanes([[r.strips[i] for r in group] for group in groups]) for i in range(5)
    )
    per_mass, per_inertia, friction = (
        _lanes([[r.per_mass[i] for r in group] for group in groups]) for i in range(3)
    )
    return LaneArrays(
        properties=_lanes([[r.properties for r in group] for group in groups]),
        state=_lanes([[r.state for r in group] for group in groups]),
        per_mass=per_mass,
        per_inertia=per_inertia,
        friction=friction,
        rest_length=rest_length,
        stiffness=stiffness,
        buckling=buckling,
        damping=damping,
        bending=bending,
        bristle=_lanes([[r.bristles for r in group] for group in groups]),
        free_length=_lanes([[r.lengths for r in group] for group in groups]),
        spring_rate=_lanes([[r.stiffnesses for r in group] for group in groups]),
        impulse=_zeros(scratch),
        record=_zeros(record),
    )


def _lanes(groups: list[list[FloatArray]]) -> FloatArray:
    """One array of every robot, one group after the other, shape (values, LANES)."""
    columns = [np.stack([values.ravel() for values in group], axis=1) for group in groups]
    filled = np.concatenate([*columns, np.zeros((1, LANES))])  # never empty
    lanes = _zeros(len(filled))
    lanes[:] = filled
    return lanes


def _zeros(rows: int) -> FloatArray:
    return aligned(rows * LANES, np.float64).reshape(-1, LANES)
