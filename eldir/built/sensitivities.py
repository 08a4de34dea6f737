"""Derivatives of a printed robot's motion with respect to its parameters.

They are used to fit a model to a real robot, and to see which parameters a motion depends on. The engine
computes them together with the motion (`eldir.engine.built.dual`, forward mode). They are derivatives of the
computed motion at a fixed step, through every impulse of the ground, and exact except where the motion itself
has a kink, such as a mass that is just about to slip.

>>> import numpy as np
>>> from eldir.built.gait import Gait, free_lengths
>>> from eldir.built.robot import build
>>> from eldir.built.sensitivities import DriveInputs, sensitivities
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
>>> found.tangents.shape == (2, *found.positions.shape)  # [m] and [m/m] per unit of the parameter
True
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from eldir.built.ground import check_terrain, place
from eldir.built.motion import (
    FREE,
    OK,
    check_states,
    check_tables,
    check_times,
    free_ranges,
    pack,
    substeps,
)
from eldir.built.robot import PrintedRobot, rest_state
from eldir.core.arguments import require_count, require_known, require_shape, require_value
from eldir.core.records import FloatArray, Record
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.terrain import Terrain

if TYPE_CHECKING:
    from eldir.engine.built.motion_batch import MotionInputs, MotionResult
    from eldir.engine.built.motion_launch import MotionArrays

_STEP = 1e-3  # of a parameter's scale


@dataclass(frozen=True, eq=False)
class DriveInputs:
    """One robot and the free lengths that move it: the arguments of `eldir.built.motion.drive`."""

    robot: PrintedRobot
    lengths: FloatArray
    """Free lengths of the active springs [m], shape (K + 1, A)."""
    interval: float
    """Time between two instants [s]."""
    free: tuple[float, float] = FREE
    """Cold and hot free length [m]."""
    state: FloatArray | None = None
    """State at the start, such as that at the end of an earlier motion, shape (4 or 7, M); by default at
    rest as assembled, on the ground."""
    terrain: Terrain | None = None
    """The ground; by default the table y = 0."""

    @property
    def start(self) -> FloatArray:
        """State at the start."""
        return place(self.robot, self.terrain) if self.state is None else self.state

    @property
    def heated_fraction(self) -> FloatArray:
        """Heated fraction: 0 cold, 1 hot, linear in the free length, shape (K + 1, A)."""
        cold, hot = self.free
        return (self.lengths - cold) / (hot - cold)

    def with_free(self, cold: float, hot: float) -> DriveInputs:
        """The same springs, heated alike, with other cold and hot free lengths [m]."""
        return replace(self, free=(cold, hot), lengths=cold + (hot - cold) * self.heated_fraction)


@dataclass(frozen=True)
class Parameter:
    """A parameter of a motion: what changes with it."""

    change: Callable[[DriveInputs, float], DriveInputs]
    """The inputs where the parameter is larger by this number."""
    scale: float = 1.0
    """Its order of magnitude: over a thousandth of it to either side the inputs must be smooth."""


@dataclass(frozen=True, eq=False)
class Sensitivity(Record):
    """Motion of a printed robot, and its derivative with respect to each of P parameters."""

    times: FloatArray
    """Times [s], shape (T,)."""
    positions: FloatArray
    """Positions [m], as `drive` computes them, shape (T, M, 2); NaN from the interval in which the simulation
    diverged."""
    tangents: FloatArray
    """Derivatives of the positions [m per unit of the parameter], shape (P, T, M, 2); NaN from the same
    interval."""
    state: FloatArray
    """State at the end, from which a further motion can continue (`PrintedMotion.state`), shape (4 or 7,
    M)."""
    state_tangents: FloatArray
    """Derivatives of `state`, shape (P, 4 or 7, M)."""
    status: int
    """`OK` (-1), or the interval in which the simulation diverged."""


def sensitivities(
    drives: Sequence[DriveInputs],
    parameters: Sequence[Sequence[str | Parameter]],
    *,
    state_tangents: Sequence[FloatArray] | None = None,
    every: int = 1,
    step: float | None = None,
) -> list[Sensitivity]:
    """Drive robots as `eldir.built.motion.drive` does, and differentiate their motion.

    `parameters[r]` are those of robot r: names of `MOTION_PARAMETERS`, or your own. `every` and `step` are
    those of `drive`. To continue an earlier call, pass its `state` in the inputs, and its `state_tangents`:
    the derivatives of the state at the start, shape (P, 4 or 7, M) for each robot. Eight parameters run side
    by side in one core, in about twice the time of the motion alone. Raises `InputError` for an unknown name,
    a parameter that does not exist with the robot's joints, a robot without parameters, arrays of the wrong
    shape, and an interval, a step or an `every` that is not positive; `EldirError` for a step that is not
    stable.
    """
    from eldir.engine.built import motion_batch

    every = _check_arguments(drives, parameters, state_tangents, every, step)
    members, tangents = [], []
    for r, (drive, mine) in enumerate(zip(drives, parameters, strict=True)):
        steps = substeps(drive.robot, drive.interval, step)
        members += [_pack(drive, steps)] * len(mine)
        for p, parameter in enumerate(mine):
            d_state = 0.0 if state_tangents is None else np.asarray(state_tangents[r])[p]
            tangents.append(_tangent(drive, _parameter(drive, parameter), steps, d_state))
    if not drives:
        return []
    outcomes = iter(motion_batch.run_motions(members, every, tangents))
    return [
        _sensitivity([next(outcomes) for _ in mine], every, drive.interval)
        for drive, mine in zip(drives, parameters, strict=True)
    ]


def _check_arguments(
    drives: Sequence[DriveInputs],
    parameters: Sequence[Sequence[str | Parameter]],
    state_tangents: Sequence[FloatArray] | None,
    every: int,
    step: float | None,
) -> int:
    """`every` as an int. Raises `InputError` for arguments that `sensitivities` does not accept."""
    require_count("lists of parameters", len(parameters), len(drives), "drive")
    robots = [drive.robot for drive in drives]
    check_tables(robots, [drive.lengths for drive in drives])
    check_states(robots, [d.start for d in drives])
    for r, (drive, mine) in enumerate(zip(drives, parameters, strict=True)):
        require_value(f"parameters of drive {r}", mine, "at least one of " + ", ".join(MOTION_PARAMETERS))
        free_ranges(drive.free, 1)
        if drive.terrain is not None:
            check_terrain(drive.terrain)
        if state_tangents is not None:
            wanted = (len(mine), *rest_state(drive.robot).shape)
            require_shape(f"tangents of the state of drive {r}", np.shape(state_tangents[r]), wanted)
    return check_times([drive.interval for drive in drives], every, step)


def _sensitivity(outcomes: Sequence[MotionResult], every: int, interval: float) -> Sensitivity:
    """The sensitivity of one robot, from the engine's outcomes of its P parameters."""
    x, state, diverged = outcomes[0].positions, outcomes[0].state, outcomes[0].diverged_at
    dx, d_state = (np.stack([o.tangents[i] for o in outcomes if o.tangents]) for i in range(2))
    if diverged != OK:
        x[diverged // every + 1 :] = dx[:, diverged // every + 1 :] = np.nan
    return Sensitivity(np.arange(len(x)) * every * interval, x, dx, state, d_state, diverged)


def _pack(drive: DriveInputs, steps: int) -> MotionInputs:
    return pack(drive.robot, drive.lengths, drive.interval, steps, drive.free, drive.start, drive.terrain)


def _tangent(
    drive: DriveInputs, parameter: Parameter, steps: int, d_state: FloatArray | float
) -> MotionArrays:
    """Derivative of the engine's inputs: two central differences, extrapolated. `d_state` is the derivative
    of the state at the start, beside what the parameter changes in it."""

    from eldir.engine.built.motion_launch import MotionArrays

    def at(h: float) -> MotionArrays:
        changed = parameter.change(drive, h)
        state = changed.start
        values = _pack(replace(changed, state=state + h * d_state), steps).values
        return values._replace(state=state)  # without `d_state`, which needs no difference

    h = _STEP * parameter.scale
    sides = [[np.asarray(values) for values in at(part * h)] for part in (1.0, -1.0, 0.5, -0.5)]
    tangents = ((8 * (c - d) - (a - b)) / (6 * h) for a, b, c, d in zip(*sides, strict=True))
    found = MotionArrays(*tangents)
    return found._replace(state=found.state + d_state)


def _parameter(drive: DriveInputs, parameter: str | Parameter) -> Parameter:
    if isinstance(parameter, Parameter):
        return parameter
    require_known("parameter", parameter, MOTION_PARAMETERS)
    if parameter in _OTHERS:
        return _OTHERS[parameter]
    if not drive.robot.parameters.acts(parameter):
        raise InputError(
            f"robots with {drive.robot.joints} have no {parameter}",
            code="robot.other-joints",
            remedy="start from BuiltParameters().with_hubs()",
        )
    value = getattr(drive.robot.parameters, parameter)
    return Parameter(
        lambda inputs, h: replace(inputs, robot=_grown(inputs.robot, parameter, h)),
        abs(value) or abs(getattr(BuiltParameters(), parameter)) or 1.0,
    )


def _grown(robot: PrintedRobot, name: str, h: float) -> PrintedRobot:
    """The robot with one of its parameters larger by h, also beyond its range: a rate of 0 can be changed to
    either side."""
    changed = copy(robot.parameters)
    object.__setattr__(changed, name, getattr(changed, name) + h)
    return robot.with_parameters(changed)


def _late(inputs: DriveInputs, h: float) -> DriveInputs:
    return replace(inputs, lengths=inputs.lengths - h * np.gradient(inputs.lengths, inputs.interval, axis=0))


_OTHERS = {
    "cold_length": Parameter(lambda d, h: d.with_free(d.free[0] + h, d.free[1]), FREE[0]),
    "hot_length": Parameter(lambda d, h: d.with_free(d.free[0], d.free[1] + h), FREE[1]),
    "lag": Parameter(_late),
    "ballast": Parameter(lambda d, h: replace(d, robot=d.robot.with_ballast(h)), BuiltParameters().hexagon),
}
MOTION_PARAMETERS = (*(f.name for f in fields(BuiltParameters) if f.name != "geometry"), *_OTHERS)
"""Names of parameters: the fields of `BuiltParameters`; cold and hot free length [m], with the same heating;
a lag of all motors [s]; ballast on the foremost mass [kg]."""
