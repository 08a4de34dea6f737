"""Exact derivatives of a printed robot's motion with respect to its parameters.

They are used to fit a model to a real robot, and to see which parameters a motion depends on. The engine
computes them together with the motion (`eldir.engine.built.motion_kernel`, forward mode). They are
derivatives of the computed motion at a fixed step, through every impulse of the ground, and exact except
where the motion itself has a kink, such as a mass that is just about to slip.

>>> import numpy as np
>>> from eldir.built.tangents import DriveInputs
>>> from eldir.built.gait import Gait, free_lengths
>>> from eldir.built.robot import build
>>> from eldir.built.sensitivities import sensitivities
>>> from eldir.genotype import random_genotypes
>>> from eldir.lattice import Lattice
>>> from eldir.morphology import develop
>>> lattice = Lattice(3, 6)
>>> genotype = random_genotypes(lattice, 1, np.random.default_rng(10), max_active=2)[0]
>>> robot = build(develop(lattice, genotype))
>>> gait = Gait(period=20.0, phase=np.array([0.0, 0.25]), duty=np.array([0.3, 0.3]))
>>> table = free_lengths(gait, cycles=1, conditioning=0)
>>> inputs = DriveInputs(robot, table.lengths[:101], table.interval)  # five seconds
>>> (found,) = sensitivities([inputs], [["friction", "hot_length"]], every=20)
>>> found.positions.shape == (6, len(robot.masses), 2)  # seconds, masses, x and y [m]
True
>>> found.slopes.shape == (2, *found.positions.shape)  # [m] and [m/m] per unit of the parameter
True
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldir.built.motion import (
    OK,
    check_states,
    check_tables,
    check_times,
    free_ranges,
    make_member,
)
from eldir.built.robot import rest_state
from eldir.built.tangents import TANGENTS, DriveInputs, Tangent
from eldir.core.arguments import require_count, require_known, require_shape, require_value
from eldir.core.records import FloatArray, Record
from eldir.errors import InputError

if TYPE_CHECKING:
    from eldir.engine.built.motion_batch import MotionInputs, MotionResult


@dataclass(frozen=True, eq=False)
class Sensitivity(Record):
    """Motion of a printed robot, and its derivative with respect to each of P parameters."""

    times: FloatArray
    """Times [s], shape (T,)."""
    positions: FloatArray
    """Positions [m], as `drive` computes them, shape (T, M, 2); NaN from the interval in which the simulation
    diverged."""
    slopes: FloatArray
    """Derivatives of the positions [m per unit of the parameter], shape (P, T, M, 2); NaN from the same
    interval."""
    state: FloatArray
    """State at the end, from which a further motion can continue, shape (4 or 7, M)."""
    state_slopes: FloatArray
    """Derivatives of `state`, shape (P, 4 or 7, M)."""
    status: int
    """`OK` (-1), or the interval in which the simulation diverged."""


def sensitivities(
    drives: Sequence[DriveInputs],
    parameters: Sequence[Sequence[str | Tangent]],
    *,
    states: Sequence[FloatArray] | None = None,
    every: int = 1,
    step: float | None = None,
) -> list[Sensitivity]:
    """Drive robots as `eldir.built.motion.drive` does, and differentiate their motion.

    `parameters[r]` are those of robot r: names of `eldir.built.tangents.TANGENTS`, or your own
    `Tangent`. `states`, `every` and `step` are those of `drive`. To continue an earlier call, pass its
    `state`, and its `state_slopes` as `Tangent.state`. Eight parameters run side by side in one core, at
    two to three times the cost of the motion alone. Raises `InputError` for an unknown name, a robot without
    parameters, arrays of the wrong shape, and an interval, a step or an `every` that is not positive;
    `EldirError` for a step that is not stable.
    """
    from eldir.engine.built import motion_batch

    every = _check_arguments(drives, parameters, states, every, step)
    members, slopes = [], []
    for r, (drive, names) in enumerate(zip(drives, parameters, strict=True)):
        require_value(f"parameters of drive {r}", names, "at least one of " + ", ".join(TANGENTS))
        state = rest_state(drive.robot) if states is None else states[r]
        mine = make_member(drive.robot, drive.lengths, drive.interval, step, drive.free, state)
        members += [mine] * len(names)
        slopes += [_tangent_of_member(drive, mine, _tangent(drive, name)) for name in names]
    if not drives:
        return []
    outcomes = iter(motion_batch.run_motions(members, every, slopes))
    return [
        _sensitivity([next(outcomes) for _ in names], every, drive.interval)
        for drive, names in zip(drives, parameters, strict=True)
    ]


def _check_arguments(
    drives: Sequence[DriveInputs],
    parameters: Sequence[Sequence[str | Tangent]],
    states: Sequence[FloatArray] | None,
    every: int,
    step: float | None,
) -> int:
    """`every` as an int. Raises `InputError` for arguments that `sensitivities` does not accept."""
    require_count("lists of parameters", len(parameters), len(drives), "drive")
    robots = [drive.robot for drive in drives]
    check_tables(robots, [drive.lengths for drive in drives])
    check_states(robots, states)
    for drive in drives:
        free_ranges(drive.free, 1)
    every = check_times([drive.interval for drive in drives], every, step)
    return every


def _sensitivity(outcomes: Sequence[MotionResult], every: int, interval: float) -> Sensitivity:
    """The sensitivity of one robot, from the engine's outcomes of its P parameters."""
    x, state, diverged = outcomes[0].positions, outcomes[0].state, outcomes[0].diverged_at
    dx, d_state = (np.stack([o.tangents[i] for o in outcomes if o.tangents]) for i in range(2))
    if diverged != OK:
        x[diverged // every + 1 :] = dx[:, diverged // every + 1 :] = np.nan
    return Sensitivity(np.arange(len(x)) * every * interval, x, dx, state, d_state, diverged)


def _tangent(drive: DriveInputs, parameter: str | Tangent) -> Tangent:
    if isinstance(parameter, Tangent):
        return parameter
    require_known("parameter", parameter, TANGENTS)
    return TANGENTS[parameter](drive)


def _tangent_of_member(drive: DriveInputs, mine: MotionInputs, d: Tangent) -> MotionInputs:
    """Derivative of all inputs of the engine."""
    from eldir.engine.built.motion_batch import MotionInputs

    robot, (dt, decay) = drive.robot, mine.properties[[0, 2]]
    order = np.argsort(~robot.active, kind="stable")
    strips = [d.rest_lengths, d.stiffness, d.buckling, d.damping, d.bending]
    inverse_masses = [
        *(
            -_broadcast(heavier, of) * inverse**2
            for heavier, of, inverse in zip(
                (d.masses, d.inertias), (robot.masses, robot.inertias), mine.inverse_masses, strict=False
            )
        ),
        _broadcast(d.friction, robot.friction),
    ]
    return MotionInputs(
        springs=mine.springs,
        direction=mine.direction,
        strips=np.stack([_broadcast(v, robot.stiffness)[order] for v in strips]),
        inverse_masses=np.stack(inverse_masses),
        properties=np.array(
            [0.0, d.gravity * dt, -dt * decay * d.drag, 0.0, d.bending_delay, *[0.0] * 5, d.downhill * dt]
        ),
        lengths=_broadcast(d.lengths, mine.lengths),
        stiffnesses=_broadcast(d.stiffnesses, mine.stiffnesses),
        state=_broadcast(d.state, mine.state),
        joints=mine.joints,
        bristles=mine.bristles,
    )


def _broadcast(value: FloatArray | float, like: FloatArray) -> FloatArray:
    require_shape("array of a tangent", np.shape(value), (), like.shape)
    return np.broadcast_to(np.asarray(value, np.float64), like.shape)
