"""The kernel of the printed robot: masses in grams, strips, Coulomb friction, prescribed free lengths.

It runs with or without tangents, which say how the motion changes with one parameter.

Groups of up to eight robots with the same springs, such as one design in all its phases, move side by side:
each has one lane of every vector, so that nothing is gathered, scattered or summed across lanes, and no
robot depends on its neighbours. Workers take groups from a queue as in `learning_kernel`. The kernel runs
forward only and keeps no history, for horizons of a million steps. It computes in float64 throughout, because
a step moves a mass by less than float32 can resolve.

A tangent is computed by forward-mode differentiation (`dual`), step by step. Each lane then is one robot with
one parameter, so that eight parameters of a robot, or one parameter of eight robots, go side by side. The
time step itself does not depend on the parameter.
"""

from collections.abc import Callable
from functools import cache

from eldir.engine.built.dual import pair
from eldir.engine.built.hubs import hub_impulses, move_hubs
from eldir.engine.built.impulses import spring_impulses
from eldir.engine.built.integration import move_masses, turn_hexagons
from eldir.engine.built.motion_launch import (
    LANES,
    LaneVector,
    MotionKind,
    MotionLaunch,
    group_arrays,
    group_sizes,
)
from eldir.engine.compiler import ti
from eldir.engine.runtime import argument_types, make_kernel

MAX_SQUARED_SPEEDS = 1e8
"""Sum of squared speeds [m2/s2] from which on a robot has diverged, looked at after every interval.

Not the bound of `eldir.engine.validity.max_speeds`, a spring's length in a step: with the stable steps of
printed robots that is 170 to 1400 m/s, but they walk at some mm/s and fall at 1 m/s. Only a step that is not
stable leads there, and `eldir.built.motion.drive` refuses those. Parts that pass through each other, for
which that bound is, do so at a walker's speed: the area of triangles finds them
(`eldir.built.robot.min_area_ratio`)."""


@cache
def motion_kernel(kind: MotionKind) -> Callable[[MotionLaunch], None]:
    """The kernel for one kind of motion; without tangents, `MotionLaunch.tangents` is not read."""

    @ti.func
    def work(worker, launch: ti.template()):
        while True:
            g = ti.atomic_add(launch.queue[0], 1)
            if g >= launch.groups:
                break
            group = ti.static(group_sizes(kind, launch, g, worker))
            values = ti.static(group_arrays(launch.values, group, g))
            derivatives = ti.static(group_arrays(launch.tangents, group, g) if kind.tangents else values)
            move_group(launch, g, group, values, derivatives)

    return make_kernel(MotionLaunch, argument_types(ti.f64), work)


@ti.func
def move_group(
    launch: ti.template(), g, group: ti.template(), values: ti.template(), derivatives: ti.template()
):
    """All intervals of a group's motion, until every robot has diverged."""
    now = ti.static(pair(values, derivatives) if group.tangents else values)
    initialize(group, values)
    if ti.static(group.tangents):
        initialize(group, derivatives)
    diverged_at = LaneVector(0.0) - LaneVector(1.0)
    for interval in range(launch.intervals[g]):
        first = launch.length_at[g] + interval * group.active
        for step in range(launch.substeps[g]):
            advance(group, now, first, step)
        if mark_diverged(group, values, diverged_at, interval) == 0:
            break
        if (interval + 1) % launch.every == 0:
            record(group, values, (interval + 1) // launch.every)
            if ti.static(group.tangents):
                record(group, derivatives, (interval + 1) // launch.every)
    for j in ti.static(range(LANES)):
        launch.status[LANES * g + j] = ti.cast(diverged_at[j], ti.i32)


@ti.func
def record(group: ti.template(), now: ti.template(), sample):
    """Records the positions, and the rotations of hubs."""
    for i in range(2 * group.masses):
        now.record[sample * group.recorded * group.masses + i] = now.state[i]
    if ti.static(group.hubs):
        for i in range(2 * group.masses):
            now.record[(sample * group.recorded + 2) * group.masses + i] = now.state[4 * group.masses + i]


@ti.func
def initialize(group: ti.template(), now: ti.template()):
    """Clears the impulses and records the first positions."""
    for i in range(group.impulses * group.masses):
        now.impulse[i] = LaneVector(0.0)
    record(group, now, 0)


@ti.func
def advance(group: ti.template(), now: ti.template(), first, step):
    """One step. A robot with fewer steps in an interval than its neighbours waits at its end."""
    going = LaneVector(ti.cast(step, ti.f64)) < group.steps
    part = ti.min(LaneVector(step + 1.0) / group.steps, LaneVector(1.0))
    if ti.static(group.hubs):
        hub_impulses(group, now, first, part)
        move_hubs(group, now, going)
    else:
        spring_impulses(group, now, first, part)
        move_masses(group, now, going)
    if ti.static(group.clamped):
        turn_hexagons(group, now, going)


@ti.func
def mark_diverged(group: ti.template(), now: ti.template(), diverged_at: ti.template(), interval):
    """Notes the interval for lanes that diverge now; returns whether any lane has not diverged."""
    squares = LaneVector(0.0)
    for i in range(2 * group.masses):
        squares = squares + now.vx[i] * now.vx[i]  # and vy, which follows
    running = 0
    for j in ti.static(range(LANES)):
        if diverged_at[j] < 0.0:
            if squares[j] < MAX_SQUARED_SPEEDS:
                running = 1
            else:
                diverged_at[j] = ti.cast(interval, ti.f64)
    return running
