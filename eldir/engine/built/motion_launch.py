"""Arguments of the printed robot's kernel, and the records of one group that its element functions read."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import fields
from typing import Any, NamedTuple

from eldir.engine.compiler import ti
from eldir.engine.kernels.memory import OffsetView, load, local, reread
from eldir.engine.runtime import Count, Eights, Integers, Number, Values
from eldir.parameters.printed import BuiltParameters, Joints

LANES = 8
"""Robots of a group, side by side in the lanes of a vector."""
LaneVector = ti.types.vector(LANES, ti.f64)
"""A value of each robot of a group."""
ZERO, ONE = LaneVector(0.0), LaneVector(1.0)
RECORDED: dict[Joints, int] = {"pins": 2, "clamped": 2, "hubs": 4}
"""Recorded numbers of each mass: x and y, of hubs also cosine and sine."""


class RobotNumbers(NamedTuple):
    """Numbers that follow from a robot's parameters; in the kernel, vectors of a group's robots, or dual
    numbers of these."""

    dt: Any
    """Time step [s]."""
    steps: Any
    """Number of steps in an interval."""
    gravity_normal_dt: Any
    """Gravity across the table times dt [m/s]."""
    gravity_tangent_dt: Any
    """Gravity along the table times dt [m/s]."""
    decay: Any
    """Factor on velocities in one step."""
    delay: Any
    """Bending delay [s]."""
    slip_angle: Any
    """Angle by which a strip turns in a socket before its friction gives way [rad]."""


PARAMETERS = tuple(field.name for field in fields(BuiltParameters))
PrintedNumbers: Any = namedtuple("PrintedNumbers", PARAMETERS)  # type: ignore[misc]
"""The parameters of a robot, by their names in `BuiltParameters`; in the kernel as above."""


class MotionKind(NamedTuple):
    """What is known of a motion while its kernel is compiled."""

    joints: Joints
    tangents: bool
    """Whether tangents are computed."""
    terrain: bool
    """Whether the ground is a terrain; otherwise it is the table y = 0."""


class MotionArrays(NamedTuple):
    """What a robot is moved by. In a launch these are the arrays of all robots, one group after the other."""

    numbers: Eights
    """`RobotNumbers`, then `PrintedNumbers`."""
    state: Eights
    """x, y, vx, vy [m, m/s]; unless strips are pinned, cosine, sine and spin [rad/s]; shape (4 or 7, M)."""
    inverse_mass: Eights
    """Inverse masses [1/kg], shape (M,)."""
    inverse_inertia: Eights
    """Inverse moments of inertia [1/(kg m2)], shape (M,)."""
    friction: Eights
    """Coulomb coefficient of each mass, shape (M,)."""
    rest_length: Eights
    """Rest length of strips [m], shape (S,), active springs first, as below."""
    stiffness: Eights
    """Stiffness of the strips in tension [N/m], shape (S,)."""
    buckling: Eights
    """Euler loads of the strips [N], shape (S,)."""
    damping: Eights
    """Dashpots of the springs [N s/m], shape (S,)."""
    bending: Eights
    """Bending stiffness of the strips [N m], shape (S,)."""
    bristle: Eights
    """Angle at which the friction of each spring's two sockets is without force [rad], shape (S, 2); only of
    hubs."""
    free_length: Eights
    """Free length of the active springs at the ends of the intervals [m], shape (K + 1, A)."""
    spring_rate: Eights
    """Stiffness of the same springs [N/m], shape (K + 1, A)."""


class TerrainArrays(NamedTuple):
    """A terrain, as `eldir.engine.kernels.contact` describes it. Without one these arrays are not read."""

    cells: Count
    last_segment: Count
    corners: Count
    """Number of corners of a hub that may meet the ground: those within 60 degrees of the lowest one, where
    the ground is steep all but the highest."""
    grid_start: Number
    cells_per_m: Number
    first_cosine: Number
    """Cosine and sine of the rotation from a hub to the first of these corners."""
    first_sine: Number
    next_cosine: Number
    """The same from one corner to the next."""
    next_sine: Number
    segments: Values
    cell_segment: Integers
    cell_top: Values
    """No ground is higher in a cell and around it [m]."""


class LaneArrays(NamedTuple):
    """Arrays that a launch has twice: as values, and as tangents, derivatives with respect to each lane's
    parameter."""

    robots: MotionArrays
    impulse: Eights
    """Scratch of the workers: x, y and, unless strips are pinned, the moment's, of each mass."""
    record: Eights
    """The recorded numbers (`RECORDED`): x and y of each mass [m], cosine and sine of each hub."""


class MotionLaunch(NamedTuple):
    """The arguments of the printed robot's kernel."""

    groups: Count
    workers: Count
    workspace: Count
    """Vectors of `impulse` for each worker."""
    every: Count
    """Number of intervals from one recorded position to the next."""
    queue: Integers
    """The next group, one number that is shared by the workers."""
    masses: Integers
    """Number of masses of each group; the next eight arrays are by group too."""
    springs: Integers
    active: Integers
    """Number of shape-memory springs, which come first."""
    intervals: Integers
    substeps: Integers
    mass_at: Integers
    """Offset of each group's masses."""
    spring_at: Integers
    length_at: Integers
    record_at: Integers
    ends: Integers
    """Two masses of each spring."""
    direction: Values
    """Unit vector of each spring at rest, from its second to its first mass."""
    status: Integers
    """For each robot -1, or the interval in which it diverged."""
    ground: TerrainArrays
    values: LaneArrays
    tangents: LaneArrays
    """The same arrays as `values` where no tangents are computed; they are not read then."""


class GroupSizes(NamedTuple):
    """One group: its kind, how large it is, where its parts begin, and what does not depend on a
    parameter."""

    kind: MotionKind
    masses: Any
    springs: Any
    active: Any
    dt: Any
    """Time step of each robot [s]; the next field is also for each robot."""
    steps: Any
    """Number of steps in an interval."""
    mass_at: Any
    spring_at: Any
    state_at: Any
    impulse_at: Any
    record_at: Any
    ends: Any
    direction: Any
    ground: TerrainArrays

    @property
    def tangents(self) -> bool:
        return self.kind.tangents

    @property
    def terrain(self) -> bool:
        return self.kind.terrain

    @property
    def clamped(self) -> bool:
        return self.kind.joints == "clamped"

    @property
    def hubs(self) -> bool:
        return self.kind.joints == "hubs"

    @property
    def recorded(self) -> int:
        return RECORDED[self.kind.joints]

    @property
    def impulses(self) -> int:
        """Impulses of each mass: x, y and, unless strips are pinned, of rotation."""
        return 2 if self.kind.joints == "pins" else 3


class GroupArrays(NamedTuple):
    """One group's values, or their tangents. Views are indexed by mass, arrays by spring."""

    numbers: RobotNumbers
    parameters: Any
    """`PrintedNumbers`."""
    x: OffsetView
    y: OffsetView
    vx: OffsetView
    vy: OffsetView
    cosine: OffsetView
    sine: OffsetView
    spin: OffsetView
    state: OffsetView
    """All of these, one after the other."""
    impulse_x: OffsetView
    impulse_y: OffsetView
    moment: OffsetView
    impulse: OffsetView
    """These three, one after the other."""
    record: OffsetView
    inverse_mass: OffsetView
    inverse_inertia: OffsetView
    friction: OffsetView
    rest_length: Any
    stiffness: Any
    buckling: Any
    damping: Any
    bending: Any
    bristle: Any
    """Two of each strip."""
    free_length: Any
    """Free lengths [m], by instant and shape-memory spring; the next field has the same indices."""
    spring_rate: Any


def group_sizes(kind: MotionKind, launch: MotionLaunch, g: Any, worker: Any) -> GroupSizes:
    """Group `g` of a launch."""
    masses, springs, active = (load(n, g) for n in (launch.masses, launch.springs, launch.active))
    numbers, _ = robot_numbers(launch.values, g)
    mass_at, spring_at, record_at = (
        reread(at, g) for at in (launch.mass_at, launch.spring_at, launch.record_at)
    )
    rows = 4 if kind.joints == "pins" else 7  # numbers of each mass's state
    return GroupSizes(
        kind, masses, springs, active, numbers.dt, numbers.steps, mass_at, spring_at,
        state_at=local(rows * mass_at), impulse_at=local(worker * launch.workspace), record_at=record_at,
        ends=launch.ends, direction=launch.direction, ground=launch.ground,
    )  # fmt: skip


def robot_numbers(arrays: LaneArrays, g: Any) -> tuple[RobotNumbers, Any]:
    """The numbers and the parameters of group `g`."""
    first = len(RobotNumbers._fields)
    count = first + len(PrintedNumbers._fields)
    numbers = [load(arrays.robots.numbers, count * g + k) for k in range(count)]
    return RobotNumbers(*numbers[:first]), PrintedNumbers(*numbers[first:])


def group_arrays(arrays: LaneArrays, group: GroupSizes, g: Any) -> GroupArrays:
    """Group `g` of a launch's values or tangents."""
    robots = arrays.robots
    x, y, vx, vy, cosine, sine, spin = (
        OffsetView(robots.state, local(group.state_at + k * group.masses)) for k in range(7)
    )
    impulse_x, impulse_y, moment = (
        OffsetView(arrays.impulse, local(group.impulse_at + k * group.masses)) for k in range(3)
    )
    return GroupArrays(
        *robot_numbers(arrays, g),
        x, y, vx, vy, cosine, sine, spin, x,
        impulse_x, impulse_y, moment, impulse_x,
        OffsetView(arrays.record, group.record_at),
        OffsetView(robots.inverse_mass, group.mass_at), OffsetView(robots.inverse_inertia, group.mass_at),
        OffsetView(robots.friction, group.mass_at),
        robots.rest_length, robots.stiffness, robots.buckling, robots.damping, robots.bending,
        robots.bristle, robots.free_length, robots.spring_rate,
    )  # fmt: skip
