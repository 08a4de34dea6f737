"""The kernel of the printed robot: masses in grams, strips, Coulomb friction, prescribed free lengths.

It runs with or without slopes, which say how the motion changes with one parameter.

Groups of up to eight robots with the same springs, such as one design in all its phases, move side by side:
each has one lane of every vector, so that nothing is gathered, scattered or summed across lanes, and no
robot depends on its neighbours. Workers take groups from a queue as in `learning_kernel`. The kernel runs
forward only and keeps no history, for horizons of a million steps. It computes in float64 throughout, because
a step moves a mass by less than float32 can resolve.

A slope is found by forward-mode differentiation by hand, step by step. Each lane then is one robot with one
parameter, so that eight parameters of a robot, or one parameter of eight robots, go side by side. Names
that end in _ are slopes: derivatives with respect to the lane's parameter. The time step itself does not
depend on it.
"""

from collections.abc import Callable
from functools import cache

from eldir.engine.built import hubs, impulses, integration
from eldir.engine.built.motion_launch import LANES, RECORDED, MotionLaunch, group_arrays, group_sizes
from eldir.engine.compiler import ti
from eldir.engine.launch import argument_types, kernel_of
from eldir.parameters.printed import Joints

BLOWN = 1e8  # sum of squared speeds [m2/s2] beyond which a robot has blown up


@cache
def motion_kernel(joints: Joints, sloped: bool) -> Callable[[MotionLaunch], None]:
    """The kernel for one kind of joints; if not `sloped`, `MotionLaunch.slopes` is not read. Hubs have no
    slopes."""
    lane = ti.types.vector(LANES, ti.f64)
    rotating, clamped, with_hubs = joints != "pins", joints == "clamped", joints == "hubs"
    rows, forces = (7, 3) if rotating else (4, 2)
    kept, hub = RECORDED[joints], hubs.functions(lane)
    spring, mass = impulses.functions(lane, clamped, sloped), integration.functions(lane, sloped)

    @ti.func
    def keep(group: ti.template(), now: ti.template(), sample):
        """Positions at an instant that is kept, and rotations of hubs."""
        for i in range(2 * group.masses):
            now.record[sample * kept * group.masses + i] = now.state[i]
        if ti.static(with_hubs):
            for i in range(2 * group.masses):
                now.record[(sample * kept + 2) * group.masses + i] = now.state[4 * group.masses + i]

    @ti.func
    def begin(group: ti.template(), now: ti.template()):
        """No impulses yet; the first kept positions."""
        for i in range(forces * group.masses):
            now.impulse[i] = lane(0.0)
        keep(group, now, 0)

    @ti.func
    def step_all(group: ti.template(), now: ti.template(), now_: ti.template(), first, step):
        # A robot with fewer steps in an interval than its neighbours waits at its end.
        going = lane(ti.cast(step, ti.f64)) < group.steps
        part = ti.min(lane(step + 1.0) / group.steps, lane(1.0))
        if ti.static(with_hubs):
            hub.pull(group, now, first, part)
            hub.move(group, now, going)
        else:
            spring.pull(group, now, now_, first, part)
            mass.move_masses(group, now, now_, going)
        if ti.static(clamped):
            mass.turn_hexagons(group, now, now_, going)

    @ti.func
    def note_blown(group: ti.template(), now: ti.template(), blown: ti.template(), interval):
        """Sets `blown` of lanes that are too fast for the first time; returns whether any lane is sound."""
        squares = lane(0.0)
        for i in range(2 * group.masses):
            squares = squares + now.vx[i] * now.vx[i]  # and vy, which follows
        sound = 0
        for j in ti.static(range(LANES)):
            if blown[j] < 0.0:
                if squares[j] < BLOWN:
                    sound = 1
                else:
                    blown[j] = ti.cast(interval, ti.f64)
        return sound

    @ti.func
    def work(worker, launch: ti.template()):
        while True:
            g = ti.atomic_add(launch.queue[0], 1)
            if g >= launch.groups:
                break
            group = ti.static(group_sizes(launch, g, worker, rows))
            now = ti.static(group_arrays(launch.values, group, g))
            now_ = ti.static(group_arrays(launch.slopes, group, g) if sloped else now)
            begin(group, now)
            if ti.static(sloped):
                begin(group, now_)
            blown = lane(0.0) - lane(1.0)
            for interval in range(launch.intervals[g]):
                first = launch.length_at[g] + interval * group.active
                for step in range(launch.substeps[g]):
                    step_all(group, now, now_, first, step)
                if note_blown(group, now, blown, interval) == 0:
                    break
                if (interval + 1) % launch.every == 0:
                    keep(group, now, (interval + 1) // launch.every)
                    if ti.static(sloped):
                        keep(group, now_, (interval + 1) // launch.every)
            for j in ti.static(range(LANES)):
                launch.status[LANES * g + j] = ti.cast(blown[j], ti.i32)

    return kernel_of(MotionLaunch, argument_types(ti.f64), work)
