"""How a built robot's motion changes with its parameters: exact derivatives, for fitting it to a real one.

The engine carries them along with the motion (`eldir.engine.driven`). They are derivatives of the
computed motion at a fixed step, through every impulse of the ground: exact except where the motion itself
has a kink, such as a mass that is just about to slip.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldir.built import BuiltRobot, rest_state
from eldir.driving import FINE, FREE, check_tables, member, stiffnesses
from eldir.errors import InputError
from eldir.frozen import FloatArray, Record

if TYPE_CHECKING:
    from eldir.engine.driven_batch import Member


@dataclass(frozen=True, eq=False)
class Direction(Record):
    """The derivative, with respect to one parameter, of everything that a drive depends on.

    One number stands for all masses, springs or instants.
    """

    masses: FloatArray | float = 0.0
    """[kg], shape (M,)."""
    inertias: FloatArray | float = 0.0
    """[kg m2], shape (M,)."""
    rest_lengths: FloatArray | float = 0.0
    """Of strips [m], shape (S,)."""
    stiffness: FloatArray | float = 0.0
    """Of strips in tension [N/m], shape (S,)."""
    buckling: FloatArray | float = 0.0
    """[N], shape (S,)."""
    damping: FloatArray | float = 0.0
    """[N s/m], shape (S,)."""
    bending: FloatArray | float = 0.0
    """[N m], shape (S,)."""
    bending_delay: float = 0.0
    """[s]"""
    gravity: float = 0.0
    drag: float = 0.0
    friction: float = 0.0
    lengths: FloatArray | float = 0.0
    """Free lengths of the active springs at the instants [m], shape (K + 1, A)."""
    stiffnesses: FloatArray | float = 0.0
    """Stiffness of the active springs at the instants [N/m], shape (K + 1, A)."""
    state: FloatArray | float = 0.0
    """What the motion begins with, shape (4 or 7, M)."""


@dataclass(frozen=True)
class Drive:
    """One robot and the free lengths that move it, as `eldir.driving.drive` takes them."""

    robot: BuiltRobot
    lengths: FloatArray
    """[m], shape (K + 1, A)."""
    interval: float
    free: tuple[float, float] = FREE
    """Cold and hot free length [m]."""

    @property
    def heated(self) -> FloatArray:
        """0 cold, 1 hot, linear in the free length, shape (K + 1, A)."""
        cold, hot = self.free
        return (self.lengths - cold) / (hot - cold)

    @property
    def stiffnesses(self) -> FloatArray:
        """Of the active springs [N/m], shape (K + 1, A)."""
        return stiffnesses(self.robot.parameters, self.lengths, self.free)

    def by_lengths(self, slopes: FloatArray) -> Direction:
        """Of a parameter that acts through the free lengths, such as a current: `slopes` (K + 1, A) are
        their derivatives [m]; stiffness follows as the spring is heated."""
        p, (cold, hot) = self.robot.parameters, self.free
        inside = (self.heated > 0) & (self.heated < 1)
        stiffening = np.where(inside, (p.hot_stiffness - p.cold_stiffness) / (hot - cold), 0.0)
        return Direction(lengths=slopes, stiffnesses=slopes * stiffening)

    def by_masses(self, slopes: FloatArray) -> Direction:
        """Of a parameter that acts through the masses; `slopes` (M,) [kg]. Hexagons' moments of inertia and
        the strips' dashpots, which have a fixed damping ratio, follow."""
        robot = self.robot
        (a, b), m = robot.springs.T, robot.masses
        share = (slopes[a] / m[a] * m[b] + slopes[b] / m[b] * m[a]) / (m[a] + m[b])
        return Direction(
            masses=slopes,
            inertias=slopes * robot.parameters.gyration**2,
            damping=np.where(robot.active, 0.0, robot.damping / 2 * share),
        )


def _tension(drive: Drive) -> Direction:
    r = drive.robot
    strips = (~r.active).astype(float)
    return Direction(stiffness=strips, damping=strips * r.damping / (2 * r.stiffness))


def _bending(drive: Drive) -> Direction:
    r = drive.robot
    if not r.clamped:
        raise InputError(
            "pinned strips have no bending stiffness", remedy="start from BuiltParameters.clamped"
        )
    return Direction(
        bending=(~r.active).astype(float), bending_delay=-r.bending_delay / (2 * r.parameters.bending)
    )


def _strip_damping(drive: Drive) -> Direction:
    r, p = drive.robot, drive.robot.parameters
    (a, b), m = r.springs.T, r.masses
    critical = 2 * np.sqrt(r.stiffness * m[a] * m[b] / (m[a] + m[b]))
    delay = 2 * np.sqrt(p.hexagon / 2 * p.pitch**2 / (12 * p.bending)) if r.clamped else 0.0
    return Direction(damping=np.where(r.active, 0.0, critical), bending_delay=float(delay))


def _hexagon(drive: Drive) -> Direction:
    r = drive.robot
    of_masses = drive.by_masses(np.ones(len(r.masses)))
    return Direction(
        masses=of_masses.masses, inertias=of_masses.inertias, damping=of_masses.damping,
        bending_delay=r.bending_delay / (2 * r.parameters.hexagon),
    )  # fmt: skip


def _halves(drive: Drive, of: FloatArray) -> Direction:
    """Half of what weighs on a spring is at each of its ends."""
    ends = drive.robot.springs.ravel()
    share = np.bincount(ends, np.repeat(of / 2, 2), minlength=len(drive.robot.masses))
    return drive.by_masses(share.astype(np.float64))


def _half_connector(drive: Drive) -> Direction:
    degree = np.bincount(drive.robot.springs.ravel(), minlength=len(drive.robot.masses))
    return drive.by_masses((degree < 6).astype(float))


def _ballast(drive: Drive) -> Direction:
    x = drive.robot.positions
    slopes = np.zeros(len(x))
    slopes[np.lexsort((x[:, 1], -x[:, 0]))[0]] = 1.0
    return drive.by_masses(slopes)


def _lag(drive: Drive) -> Direction:
    return Direction(
        lengths=-np.gradient(drive.lengths, drive.interval, axis=0),
        stiffnesses=-np.gradient(drive.stiffnesses, drive.interval, axis=0),
    )


PARAMETERS: dict[str, Callable[[Drive], Direction]] = {
    "tension": _tension,
    "buckling": lambda d: Direction(buckling=(~d.robot.active).astype(float)),
    "bending": _bending,
    "strip_damping": _strip_damping,
    "cold_stiffness": lambda d: Direction(stiffnesses=1 - np.clip(d.heated, 0, 1)),
    "hot_stiffness": lambda d: Direction(stiffnesses=np.clip(d.heated, 0, 1)),
    "active_damping": lambda d: Direction(damping=d.robot.active.astype(float)),
    "cold_length": lambda d: Direction(lengths=1 - d.heated),
    "hot_length": lambda d: Direction(lengths=d.heated),
    "lag": _lag,
    "friction": lambda d: Direction(friction=1.0),
    "gravity": lambda d: Direction(gravity=1.0),
    "drag": lambda d: Direction(drag=1.0),
    "hexagon": _hexagon,
    "half_connector": _half_connector,
    "strip": lambda d: _halves(d, (~d.robot.active).astype(float)),
    "active_spring": lambda d: _halves(d, d.robot.active.astype(float)),
    "gyration": lambda d: Direction(inertias=2 * d.robot.masses * d.robot.parameters.gyration),
    "ballast": _ballast,
}
"""What `sensitivities` knows by name: fields of `BuiltParameters`; the cold and the hot free length [m], with
the course of heating as it is; a lag of all motors [s]; ballast on the foremost mass [kg]."""


@dataclass(frozen=True, eq=False)
class Sensitivity(Record):
    """A built robot's motion, and its derivative with respect to each of P parameters."""

    times: FloatArray
    """[s], shape (T,)."""
    positions: FloatArray
    """As `drive` gives them [m], shape (T, M, 2); NaN from where the robot blew up."""
    slopes: FloatArray
    """[m per unit of the parameter], shape (P, T, M, 2); NaN from where the robot blew up."""
    state: FloatArray
    """At the end, to go on from, shape (4 or 7, M)."""
    state_slopes: FloatArray
    """Of `state`, shape (P, 4 or 7, M)."""
    status: int
    """`FINE` (-1), or the interval in which it blew up."""


def sensitivities(
    drives: Sequence[Drive],
    parameters: Sequence[Sequence[str | Direction]],
    *,
    states: Sequence[FloatArray] | None = None,
    every: int = 1,
    step: float | None = None,
) -> list[Sensitivity]:
    """Drive robots as `eldir.driving.drive` does, and differentiate their motion.

    `parameters[r]`, of robot r: names of `PARAMETERS`, or directions of one's own. To go on from an
    earlier call, give its states, and its state slopes as `Direction.state`. Eight parameters go side by
    side in one core, at two to three times the cost of the motion alone.
    """
    from eldir.engine import driven_batch

    if len(parameters) != len(drives):
        raise InputError(
            "every drive needs its parameters", expected=str(len(drives)), found=str(len(parameters))
        )
    check_tables([d.robot for d in drives], [d.lengths for d in drives])
    members, slopes = [], []
    for r, (drive, names) in enumerate(zip(drives, parameters, strict=True)):
        if not names:
            raise InputError(
                f"drive {r} has no parameters", expected="at least one of " + ", ".join(PARAMETERS)
            )
        state = rest_state(drive.robot) if states is None else states[r]
        mine = member(drive.robot, drive.lengths, drive.interval, step, drive.free, state)
        members += [mine] * len(names)
        slopes += [_slope(drive, mine, _direction(drive, name)) for name in names]
    if not drives:
        return []
    outcomes = driven_batch.run(members, every, slopes)
    found, first = [], 0
    for drive, names in zip(drives, parameters, strict=True):
        part = outcomes[first : first + len(names)]
        first += len(names)
        x, ended, blown = part[0].positions, part[0].state, part[0].blown
        dx, ended_ = (np.stack([o.slopes[i] for o in part if o.slopes]) for i in range(2))
        if blown != FINE:
            x[blown // every + 1 :] = dx[:, blown // every + 1 :] = np.nan
        times = np.arange(len(x)) * every * drive.interval
        found.append(Sensitivity(times, x, dx, ended, ended_, blown))
    return found


def _direction(drive: Drive, parameter: str | Direction) -> Direction:
    if isinstance(parameter, Direction):
        return parameter
    if parameter not in PARAMETERS:
        raise InputError("unknown parameter", expected=" | ".join(PARAMETERS), found=repr(parameter))
    return PARAMETERS[parameter](drive)


def _slope(drive: Drive, mine: Member, d: Direction) -> Member:
    """The derivative of what the engine is told."""
    from eldir.engine.driven_batch import Member

    robot, (dt, decay) = drive.robot, mine.properties[[0, 2]]
    order = np.argsort(~robot.active, kind="stable")
    strips = [d.rest_lengths, d.stiffness, d.buckling, d.damping, d.bending]
    heavier = np.stack([_full(v, m) for v, m in ((d.masses, robot.masses), (d.inertias, robot.inertias))])
    return Member(
        springs=mine.springs,
        direction=mine.direction,
        strips=np.stack([_full(v, robot.stiffness)[order] for v in strips]),
        per_mass=-heavier * mine.per_mass**2,
        properties=np.array([0.0, d.gravity * dt, -dt * decay * d.drag, d.friction, 0.0, d.bending_delay]),
        lengths=_full(d.lengths, mine.lengths),
        stiffnesses=_full(d.stiffnesses, mine.stiffnesses),
        state=_full(d.state, mine.state),
    )


def _full(value: FloatArray | float, like: FloatArray) -> FloatArray:
    if np.shape(value) not in ((), like.shape):
        raise InputError(
            "a direction does not fit its robot", expected=str(like.shape), found=str(np.shape(value))
        )
    return np.broadcast_to(np.asarray(value, np.float64), like.shape)
