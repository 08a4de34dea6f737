"""Motions of printed robots as one batch: sort into groups of the same body, pack, launch the kernel,
unpack."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir.engine.built.motion_kernel import motion_kernel
from eldir.engine.built.motion_launch import (
    LANES,
    PARAMETERS,
    RECORDED,
    LaneArrays,
    MotionArrays,
    MotionKind,
    MotionLaunch,
    RobotNumbers,
)
from eldir.engine.built.terrain import pack_terrain
from eldir.engine.compiler import aligned
from eldir.engine.runtime import set_compile_options, start
from eldir.engine.threads import worker_threads
from eldir.morphology import offsets
from eldir.parameters.printed import Joints
from eldir.terrain import Terrain

_FIELDS = len(MotionArrays._fields)


@dataclass(frozen=True)
class MotionInputs:
    """One robot and its commands."""

    springs: IntArray
    """Active ones first, shape (S, 2)."""
    direction: FloatArray
    """Unit vector from the second to the first mass of every spring at rest, shape (S, 2)."""
    joints: Joints
    values: MotionArrays
    terrain: Terrain | None = None
    """The ground; by default the table y = 0."""

    @property
    def group_key(self) -> tuple[object, ...]:
        """Robots with the same key move side by side."""
        lengths = self.values.free_length.shape
        return (self.springs.tobytes(), self.direction.tobytes(), lengths, *self.launch_key)

    @property
    def launch_key(self) -> tuple[str, bytes]:
        """Robots with the same key go into one launch of the kernel."""
        ground = self.terrain
        columns = () if ground is None else (ground.x0, ground.slope, ground.intercept)
        return (self.joints, np.array(columns).tobytes())

    @property
    def corner(self) -> float:
        """Distance from a hub's centre to its corners [m]."""
        return float(self.values.numbers[len(RobotNumbers._fields) + PARAMETERS.index("corner")])

    @property
    def work(self) -> float:
        """Springs times steps."""
        return float(len(self.springs) * len(self.values.free_length) * self.steps)

    @property
    def steps(self) -> int:
        """Number of steps in an interval."""
        return int(self.values.numbers[RobotNumbers._fields.index("steps")])


class MotionResult(NamedTuple):
    """Motion of one member."""

    positions: FloatArray
    """Positions [m], shape (K // every + 1, M, 2)."""
    rotations: FloatArray
    """Cosine and sine of the hubs' rotations, shape (K // every + 1, M, 2); without hubs (..., 0)."""
    state: FloatArray
    """State at the end, laid out as `MotionArrays.state`."""
    diverged_at: int
    """-1, or the interval in which it diverged."""
    tangents: tuple[FloatArray, FloatArray] | None = None
    """Tangents of positions and state, if they were requested."""


def run_motions(
    members: Sequence[MotionInputs], every: int, tangents: Sequence[MotionArrays] | None = None
) -> list[MotionResult]:
    """Moves all robots; results are in input order, and no robot's result depends on the others.

    `tangents`, one for each robot, are derivatives of its values with respect to a parameter. With them, the
    results contain the derivatives of the motion too.
    """
    start()
    same_body: dict[tuple[object, ...], list[int]] = {}
    for i, member in enumerate(members):
        same_body.setdefault(member.group_key, []).append(i)
    groups = [same[i : i + LANES] for same in same_body.values() for i in range(0, len(same), LANES)]
    groups.sort(key=lambda group: -max(members[i].work for i in group))  # the longest first
    by_robot: dict[int, MotionResult] = {}
    for key in sorted({m.launch_key for m in members}):
        alike = [g for g in groups if members[g[0]].launch_key == key]
        # Unused lanes repeat the group's first robot.
        filled = [(g + g[:1] * LANES)[:LANES] for g in alike]
        results = _run_groups(
            [[members[i] for i in g] for g in filled],
            None if tangents is None else [[tangents[i] for i in g] for g in filled],
            every,
        )
        for group, found in zip(alike, results, strict=True):
            by_robot |= dict(zip(group, found, strict=False))
    return [by_robot[i] for i in range(len(members))]


def _run_groups(
    groups: list[list[MotionInputs]], tangents: list[list[MotionArrays]] | None, every: int
) -> list[list[MotionResult]]:
    """Motions of groups of `LANES` robots with the same joints on the same ground."""
    first = [group[0] for group in groups]
    kind = MotionKind(first[0].joints, tangents is not None, first[0].terrain is not None)
    masses = np.array([len(f.values.inverse_mass) for f in first], np.int32)
    active = np.array([f.values.free_length.shape[1] for f in first], np.int32)
    intervals = np.array([len(f.values.free_length) - 1 for f in first], np.int32)
    record_at = offsets((intervals // every + 1) * RECORDED[first[0].joints] * masses)
    workers, workspace = min(worker_threads(), len(groups)), 3 * int(masses.max())
    room = workspace * workers, int(record_at[-1])
    values = _lane_arrays([[robot.values for robot in group] for group in groups], *room)
    tangent_values = None if tangents is None else _lane_arrays(tangents, *room)
    launch = MotionLaunch(
        groups=len(groups), workers=workers, workspace=workspace, every=every, queue=aligned(1, np.int32),
        masses=masses, springs=np.array([len(f.springs) for f in first], np.int32), active=active,
        intervals=intervals,
        substeps=np.array([max(robot.steps for robot in group) for group in groups], np.int32),
        mass_at=offsets(masses), spring_at=offsets([len(f.springs) for f in first]),
        length_at=offsets((intervals + 1) * active), record_at=record_at,
        ends=np.concatenate([f.springs.ravel() for f in first]),
        direction=np.concatenate([f.direction.ravel() for f in first]),
        status=aligned(len(groups) * LANES, np.int32),
        ground=pack_terrain(first[0].terrain, max(robot.corner for group in groups for robot in group)),
        values=values, tangents=values if tangent_values is None else tangent_values,
    )  # fmt: skip
    set_compile_options("f64")
    motion_kernel(kind)(launch)
    arrays = [values] if tangent_values is None else [values, tangent_values]
    return [_group_results(launch, arrays, g, len(f.values.state), f.joints) for g, f in enumerate(first)]


def _group_results(
    launch: MotionLaunch, arrays: list[LaneArrays], g: int, rows: int, joints: Joints
) -> list[MotionResult]:
    """Motions of the robots of group `g`, whose masses have `rows` numbers of state each."""
    masses, mass_at = launch.masses[g], launch.mass_at[g]
    record = slice(launch.record_at[g], launch.record_at[g + 1])
    state = slice(rows * mass_at, rows * (mass_at + masses))
    shape = (-1, RECORDED[joints], masses)

    def result(lane: int) -> MotionResult:
        motions = [a.record[record, lane].reshape(shape).transpose(0, 2, 1).copy() for a in arrays]
        states = [a.robots.state[state, lane].reshape(rows, masses).copy() for a in arrays]
        tangents = (motions[1][..., :2], states[1]) if len(arrays) == 2 else None
        x, rotations = motions[0][..., :2], motions[0][..., 2:]
        return MotionResult(x, rotations, states[0], int(launch.status[LANES * g + lane]), tangents)

    return [result(lane) for lane in range(LANES)]


def _lane_arrays(groups: list[list[MotionArrays]], scratch: int, record: int) -> LaneArrays:
    """The values of all robots, or their tangents, with room for impulses and recorded numbers."""
    by_field = ([[np.asarray(robot[k]) for robot in group] for group in groups] for k in range(_FIELDS))
    return LaneArrays(MotionArrays(*map(_lanes, by_field)), impulse=_zeros(scratch), record=_zeros(record))


def _lanes(groups: list[list[FloatArray]]) -> FloatArray:
    """One array of every robot, one group after the other, shape (values, LANES)."""
    columns = [np.stack([values.ravel() for values in group], axis=1) for group in groups]
    filled = np.concatenate([*columns, np.zeros((1, LANES))])  # never empty
    lanes = _zeros(len(filled))
    lanes[:] = filled
    return lanes


def _zeros(rows: int) -> FloatArray:
    return aligned(rows * LANES, np.float64).reshape(-1, LANES)
