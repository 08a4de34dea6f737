"""Motion of printed robots whose active springs follow prescribed free lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldir.built.ground import check_terrain, place
from eldir.built.robot import PrintedRobot, rest_state
from eldir.built.stability import STICKS, stable_step, stable_step_in_any_pose
from eldir.core.arguments import require_count, require_shape, require_value, require_whole_number
from eldir.core.records import FloatArray, Record
from eldir.errors import EldirError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.terrain import Terrain

if TYPE_CHECKING:
    from eldir.engine.built.motion_batch import MotionInputs

OK = -1
FREE = (SpringParameters().cold_length, SpringParameters().hot_length)
"""Cold and hot free length of the nominal spring [m]."""
_SAFETY = 0.95  # of the largest step that is stable in any pose
_MAX_STEPS = 1_000_000_000  # that the engine counts, between two instants
_LEAVE_OUT = "leave out `step`: the engine then takes the largest stable one"


@dataclass(frozen=True, eq=False)
class PrintedMotion(Record):
    """Motion of one printed robot."""

    times: FloatArray
    """Times [s], shape (T,)."""
    positions: FloatArray
    """Positions [m], shape (T, M, 2); NaN from the interval in which the simulation diverged."""
    rotations: FloatArray
    """Cosine and sine of the hubs' rotations, shape (T, M, 2), NaN likewise; shape (T, M, 0) without hubs."""
    state: FloatArray
    """State at the end, from which a further motion can continue: x, y, vx, vy (unless
    strips are pinned, also cosine, sine, spin), shape (4 or 7, M). It leaves out the friction in the sockets
    of hubs, which begins anew: their motion in pieces is not exactly that without a break."""
    status: int
    """`OK` (-1), or the interval in which the simulation diverged."""


def drive(
    robots: Sequence[PrintedRobot],
    lengths: Sequence[FloatArray],
    interval: float,
    *,
    states: Sequence[FloatArray] | None = None,
    every: int = 1,
    step: float | None = None,
    free: tuple[float, float] | Sequence[tuple[float, float]] = FREE,
    terrain: Terrain | None = None,
) -> list[PrintedMotion]:
    """Move robots by prescribed free lengths of their active springs, side by side.

    `lengths[r]`: free lengths [m] of robot r at instants 0, interval, ... [s], linear between them, shape
    (K + 1, A). Positions are kept at every `every`-th instant. `states` are those at the end of earlier
    motions, to continue them. `step` [s]: the largest integration step; by default 0.95 of what is stable in
    any pose. `free`: cold and hot free length [m], between which the stiffness goes from cold to hot, for all
    robots or for each. For choices among many, drive `PrintedRobot.coarse`: it takes a seventh of the time.
    `terrain`: the ground, by default the table y = 0; robots without a state begin where
    `eldir.built.ground.place` puts them. Raises `InputError` for a table or a state of the wrong shape, an
    interval, a step or an `every` that is not positive, a hot free length that is not longer, and a terrain
    that is too steep or too fine; `EldirError` for a step that is not stable.
    """
    from eldir.engine.built import motion_batch

    check_tables(robots, lengths)
    check_states(robots, states)
    every = check_times([interval] * len(robots), every, step)
    if terrain is not None:
        check_terrain(terrain)
    if not robots:
        return []
    ranges = free_ranges(free, len(robots))
    starts = states if states is not None else [place(robot, terrain) for robot in robots]
    members = [
        pack(
            robot,
            np.asarray(table, np.float64),
            interval,
            substeps(robot, interval, step),
            ends,
            state,
            terrain,
        )
        for robot, table, ends, state in zip(robots, lengths, ranges, starts, strict=True)
    ]
    motions = []
    for x, rotations, end, diverged, _ in motion_batch.run_motions(members, every):
        if diverged != OK:
            x[diverged // every + 1 :] = rotations[diverged // every + 1 :] = np.nan
        motions.append(PrintedMotion(np.arange(len(x)) * every * interval, x, rotations, end, diverged))
    return motions


def check_tables(robots: Sequence[PrintedRobot], lengths: Sequence[FloatArray]) -> None:
    """Raise `InputError` unless there are free lengths of every active spring at two instants at least."""
    require_count("tables of lengths", len(lengths), len(robots))
    for r, (robot, table) in enumerate(zip(robots, map(np.asarray, lengths), strict=True)):
        name = f"lengths of robot {r}"
        require_shape(name, table.shape, (None, robot.active.sum()))
        require_value(
            name, len(table) > 1 and np.isfinite(table).all(), "finite, at 2 instants or more", table
        )


def check_states(robots: Sequence[PrintedRobot], states: Sequence[FloatArray] | None) -> None:
    """Raise `InputError` unless there are no states, or one of the right shape for each robot."""
    if states is None:
        return
    require_count("states", len(states), len(robots))
    for r, (robot, state) in enumerate(zip(robots, states, strict=True)):
        remedy = f"its joints are {robot.joints}: pass the `state` of an earlier motion of the same robot"
        require_shape(f"state of robot {r}", np.shape(state), rest_state(robot).shape, remedy=remedy)


def check_times(intervals: Sequence[float], every: int, step: float | None) -> int:
    """`every` as an int. Raises `InputError` unless all are positive, and the engine can count the steps."""
    for interval in intervals:
        require_value("interval", 0 < interval < np.inf, "more than 0 s", interval)
        require_value(
            "step",
            step is None or interval / _MAX_STEPS < step < np.inf,
            f"more than 0 s, and at most {_MAX_STEPS} steps an interval",
            f"{step} s",
            _LEAVE_OUT,
        )
    return require_whole_number("every", every, 1, _MAX_STEPS)


def free_ranges(
    free: tuple[float, float] | Sequence[tuple[float, float]], robots: int
) -> list[tuple[float, float]]:
    """Cold and hot free length of each robot [m]. Raises `InputError`."""
    given = np.asarray(free, np.float64)
    require_shape("free", given.shape, (2,), (robots, 2))
    longer = (given[..., 0] < given[..., 1]).all()
    require_value("free", longer, "a cold length, then a longer hot one [m]", given.tolist())
    return [(float(cold), float(hot)) for cold, hot in np.broadcast_to(given, (robots, 2))]


def pack(
    robot: PrintedRobot,
    lengths: FloatArray,
    interval: float,
    steps: int,
    free: tuple[float, float],
    state: FloatArray,
    terrain: Terrain | None = None,
) -> MotionInputs:
    """The inputs of the engine for one robot, with `steps` integration steps in an interval."""
    from eldir.engine.built.motion_batch import MotionInputs
    from eldir.engine.built.motion_launch import PARAMETERS, MotionArrays, RobotNumbers

    p, dt = robot.parameters, interval / steps
    numbers = RobotNumbers(
        dt=dt,
        steps=steps,
        gravity_normal_dt=p.gravity * np.cos(p.tilt) * dt,
        gravity_tangent_dt=-p.gravity * np.sin(p.tilt) * dt,
        decay=np.exp(-p.drag * dt),
        delay=robot.bending_delay,
        slip_angle=STICKS,
    )
    order = np.argsort(~robot.active, kind="stable")
    return MotionInputs(
        springs=robot.springs[order],
        direction=robot.directions[order],
        joints=robot.joints,
        terrain=terrain,
        values=MotionArrays(
            numbers=np.array([*numbers, *(getattr(p, name) for name in PARAMETERS)]),
            state=state,
            inverse_mass=1 / robot.masses,
            inverse_inertia=1 / robot.inertias,
            friction=robot.friction,
            rest_length=robot.rest_lengths[order],
            stiffness=robot.stiffness[order],
            buckling=np.where(np.isinf(robot.buckling), 1e30, robot.buckling)[order],
            damping=robot.damping[order],
            bending=robot.bending[order],
            bristle=_bristle_angles(robot, state)[order] if robot.joints == "hubs" else np.zeros((0, 2)),
            free_length=lengths,
            spring_rate=stiffnesses(p, lengths, free),
        ),
    )


def _bristle_angles(robot: PrintedRobot, state: FloatArray) -> FloatArray:
    """Angles between each spring and its two hubs [rad], shape (S, 2): no friction acts yet."""
    (a, b), along = robot.springs.T, robot.directions.T
    turned = [state[4, i] * along - state[5, i] * along[::-1] * [[1.0], [-1.0]] for i in (a, b)]
    d = state[:2, a] - state[:2, b] - robot.parameters.socket * (turned[0] + turned[1])
    d /= np.linalg.norm(d, axis=0)
    return np.arcsin(np.clip(np.stack([d[0] * t[1] - d[1] * t[0] for t in turned], axis=1), -1, 1))


def stiffnesses(p: BuiltParameters, lengths: FloatArray, free: tuple[float, float]) -> FloatArray:
    """Stiffness of active springs [N/m]: from cold to hot as their free length goes from `free[0]` to
    `free[1]` [m]."""
    cold, hot = free
    heated = np.clip((lengths - cold) / (hot - cold), 0, 1)
    return p.cold_stiffness + (p.hot_stiffness - p.cold_stiffness) * heated


def substeps(robot: PrintedRobot, interval: float, step: float | None) -> int:
    """Integration steps in an interval. Raises `EldirError` for a `step` [s] that is not stable."""
    if step is None:
        return int(np.ceil(interval / (_SAFETY * stable_step_in_any_pose(robot))))
    largest = stable_step(robot)
    if step > largest:
        raise EldirError(
            "the step is too large for this robot",
            code="scene.large-step",
            expected=f"at most {largest * 1e3:.4g} ms",
            found=f"{step * 1e3:.4g} ms",
            remedy=_LEAVE_OUT,
        )
    return int(np.ceil(interval / step))
