"""The kernel of the closed-loop robots: workers take robots from a queue; each robot is simulated,
differentiated and trained in one go.

Everything a worker touches lies in its own workspace, so results depend neither on the number of threads nor
on which robots are in the queue. Whether to go backward or to record is decided once for each robot, not
compiled in. One code for all cases means that a rollout shows, to the last bit, what was learned.
"""

from collections.abc import Callable
from functools import cache

from eldir.engine.compiler import ti
from eldir.engine.kernels import layout
from eldir.engine.kernels.contact import FRICTION, absolute, reset_segments
from eldir.engine.kernels.controller import (
    actuate,
    actuate_adjoint,
    add_weight_gradients,
    clear_sensed_gradients,
    transpose_weights,
)
from eldir.engine.kernels.layout import CHUNK, SCALARS
from eldir.engine.kernels.learning_launch import (
    LearningLaunch,
    cotangents_view,
    physics_gradients_view,
    robot_view,
    weights_view,
    workspace_view,
)
from eldir.engine.kernels.mass_spring import (
    advance_masses,
    advance_masses_adjoint,
    clear_springs,
    spring_impulses,
    spring_impulses_adjoint,
)
from eldir.engine.kernels.simd import fill, max_of, vectors
from eldir.engine.runtime import argument_types, make_kernel
from eldir.engine.validity import MAX_SQUARE, NO_GRADIENT, OK


@cache
def learning_kernel(precision: str) -> Callable[[LearningLaunch], None]:
    """The kernel for 'f32' or 'f64'."""
    simd = vectors(precision)

    @ti.func
    def work(worker, launch: ti.template()):
        while True:
            r = ti.atomic_add(launch.queue[0], 1)
            if r >= launch.robots:
                break
            decay = launch.arrays.scalars[SCALARS * r]
            gravity_dt, friction, max_squared_speed = (
                launch.arrays.scalars[SCALARS * r + 1],
                launch.arrays.scalars[SCALARS * r + 2],
                launch.arrays.scalars[SCALARS * r + 3],
            )
            scalars = ti.static((decay, gravity_dt, friction, max_squared_speed))
            at = ti.static(layout.read_row(launch.offsets, r))
            n = ti.static(layout.size(at.masses, at.motors, at.cells, at.reach))
            inverse_count = ti.cast(1, simd.real) / n.masses
            body = ti.static(robot_view(simd, launch, scalars, n, inverse_count, at))
            owner = worker
            if launch.settings.kept_from >= 0:
                owner = r - launch.settings.kept_from
            memory = ti.static(workspace_view(launch, owner, n, r))
            weights = ti.static(weights_view(launch, n, at))
            robot = ti.static(body._replace(weights=weights, work=memory.scratch))
            clear_springs(robot)
            launch.status[r] = train(robot, launch, r, at, memory.history)
            if launch.settings.record:
                write_states(launch, at, n, memory.history)

    return make_kernel(LearningLaunch, argument_types(simd.real), work)


@ti.func
def train(body: ti.template(), launch: ti.template(), r, at: ti.template(), history: ti.template()):
    """Rollouts, gradients and updates of one robot; returns its status. A loss whose gradient is not finite
    does not count."""
    settings, n, weights = ti.static(launch.settings, body.n, body.weights)
    robot = ti.static(body._replace(d_physics=physics_gradients_view(launch, n, at)))
    cotangents = ti.static(cotangents_view(launch, n, at))
    g_weights = ti.static(robot.work.g_weights)
    iterations, rows = settings.iterations, n.weight_rows
    controlled = n.motors > 0 or settings.control_passive
    best_loss = ti.cast(0, robot.simd.real)
    status = OK
    for i in range(iterations + 1):
        if controlled:
            transpose_weights(robot)
        if settings.resumed:  # noqa: SIM108 # a conditional expression would simulate in both cases
            status = launch.status[r]
        else:
            status = rollout(robot, history, settings.steps)
        if status != OK:
            break
        loss = mean_displacement_loss(robot, history, settings.steps)
        if not (loss * loss < MAX_SQUARE):
            status = settings.steps - 1
            break
        differentiates = settings.backward and (i < iterations or iterations == 0)
        if ti.static(not settings.physics_gradients):
            differentiates = differentiates and controlled
        square = ti.cast(0, robot.simd.real)
        if differentiates:
            growth = differentiate(robot, history, cotangents, settings.steps, settings.window)
            launch.growth[r * (iterations + 1) + i] = growth * n.masses
            square = squared_norm(robot.simd, g_weights, rows, launch.rule.bias_gain)
            if not (square < MAX_SQUARE):
                status = NO_GRADIENT
                break
        launch.losses[r * (iterations + 1) + i] = loss
        if settings.backward:
            if iterations > 0 and (i == 0 or loss < best_loss):
                best_loss = loss
                write_weights(launch.best, at, weights, rows)
            if differentiates:
                if iterations > 0:
                    update_weights(weights, g_weights, square, rows, ti.static(launch.rule))
                else:  # the gradient is the result
                    write_weights(launch.best, at, g_weights, rows)
    return status


@ti.func
def write_weights(best: ti.template(), at: ti.template(), weights: ti.template(), rows):
    for k in range(rows):
        best[(at.weight_at >> 5) + k] = weights.all.row[k]


@ti.func
def write_states(launch: ti.template(), at: ti.template(), n: ti.template(), history: ti.template()):
    """Writes x, y, vx, vy and the activations of every state, in the history's layout."""
    for t in range(launch.settings.steps + 1):
        state = ti.static(history.at(t))
        q = at.record_at + t * n.recorded_rows
        for k in range(4 * n.cell_rows):
            launch.record[q + k] = state.x[k]
        for k in range(2 * n.motor_blocks):
            launch.record[q + 4 * n.cell_rows + k] = state.action[k]


@ti.func
def write_initial_state(robot: ti.template(), first: ti.template()):
    for i in range(robot.n.cell_rows):
        x, y = robot.start[i], robot.start[robot.n.cell_rows + i]
        vx, vy = robot.velocity[i], robot.velocity[robot.n.cell_rows + i]
        if ti.static(robot.staggered):
            x, y = x + 0.5 * robot.dt * vx, y + 0.5 * robot.dt * vy
        first.x[i], first.y[i] = x, y
        first.vx[i], first.vy[i] = vx, vy


@ti.func
def rollout(robot: ti.template(), history: ti.template(), steps):
    """Simulates all steps; returns the step at which the robot diverged, or -1."""
    write_initial_state(robot, ti.static(history.at(0)))
    if ti.static(robot.ground.contact == FRICTION):
        for i in range(robot.n.cell_rows):
            reset_segments(robot, robot.work.segments_below, i)
    diverged_at = OK
    for t in range(steps):
        now = ti.static(history.at(t))
        after = ti.static(history.at(t + 1))
        if robot.n.motors > 0 or robot.control_passive:
            actuate(robot, now, ti.static(history.at(ti.max(t - 1, 0))), t)
        spring_impulses(robot, now)
        too_fast = advance_masses(robot, now, after)
        if diverged_at < 0 and too_fast.sum() > 0.5:
            diverged_at = t
            if robot.stop_on_divergence:
                break
    return diverged_at


@ti.func
def mean_displacement_loss(robot: ti.template(), history: ti.template(), steps):
    """Minus the mean forward displacement."""
    last, before = ti.static(history.at(steps), history.at(steps - 1))
    forward = robot.simd.lanes(0.0)
    for i in range(robot.n.cell_rows):
        forward += last.x[i] - robot.start[i]
        if ti.static(robot.staggered):
            forward += 0.5 * (before.x[i] - last.x[i])
    return -forward.sum() * robot.inverse_count


@ti.func
def set_final_gradient(robot: ti.template(), share):
    """The gradient of the loss with respect to the state in which a window ends."""
    g, simd = ti.static(robot.work.g, robot.simd)
    for i in range(robot.n.cell_rows):
        g.x[i] = share * robot.mask[i]
        g.y[i], g.vx[i], g.vy[i] = simd.lanes(0.0), simd.lanes(0.0), simd.lanes(0.0)


@ti.func
def add_cotangent(robot: ti.template(), cotangents: ti.template(), t):
    """Adds the given cotangents of the positions and velocities of state t to their gradients."""
    g = ti.static(robot.work.g)
    rows, q = robot.n.cell_rows, t * cotangents.stride
    if cotangents.given:
        for i in range(rows):
            g.x[i] = g.x[i] + cotangents.states[q + i]
            g.y[i] = g.y[i] + cotangents.states[q + rows + i]
    if cotangents.complete:
        for i in range(rows):
            g.vx[i] = g.vx[i] + cotangents.states[q + 2 * rows + i]
            g.vy[i] = g.vy[i] + cotangents.states[q + 3 * rows + i]


@ti.func
def add_action_cotangent(
    robot: ti.template(), now: ti.template(), cotangents: ti.template(), t, delta: ti.template()
):
    """Adds the given cotangents of the activations of state t, before tanh, to their deltas."""
    if cotangents.complete:
        q = t * cotangents.stride + 4 * robot.n.cell_rows
        for b in range(2 * robot.n.motor_blocks):
            action = now.action[b]
            delta[b] = delta[b] + cotangents.states[q + b] * (1.0 - action * action)


@ti.func
def differentiate(robot: ti.template(), history: ti.template(), cotangents: ti.template(), steps, window):
    """Writes the gradient of the loss with respect to the weights into `work.g_weights` and, if requested,
    with respect to physics into `d_physics`: the reverse sweep. With a window, the gradient is that of the
    displacements in all windows, each traced back to its own beginning only.

    Returns the greatest gradient of a position, looked at every `CHUNK` steps and at the beginning of
    windows."""
    n, work, g = ti.static(robot.n, robot.work, robot.work.g)
    controlled = n.motors > 0 or robot.control_passive
    for i in range(n.weight_rows):
        work.g_weights.all.row[i] = robot.simd.row(0.0)
    share = -robot.inverse_count * (0.5 if ti.static(robot.staggered) else 1.0)
    if ti.static(robot.physics_gradients):
        fill(robot.simd, robot.d_physics.stiffness_dt, n.physics_values >> 4, 0.0)
        share *= ti.select(cotangents.given, 0.0, 1.0)
    set_final_gradient(robot, share)
    clear_sensed_gradients(robot)
    kept = 0
    largest = robot.simd.lanes(0.0)
    for back in range(steps):
        t = steps - 1 - back
        if back > 0 and (t + 1) % window == 0:
            largest = ti.max(largest, position_gradients(robot))
            set_final_gradient(robot, share)
        if ti.static(robot.physics_gradients):
            add_cotangent(robot, cotangents, t + 1)
        now = ti.static(history.at(t))
        advance_masses_adjoint(robot, now)
        deltas = ti.static(work.action_deltas + kept * n.padded_motors)
        spring_impulses_adjoint(robot, now, deltas)
        if ti.static(robot.physics_gradients):
            add_action_cotangent(robot, now, cotangents, t, deltas)
        if controlled:
            actuate_adjoint(robot, now, ti.static(history.at(ti.max(t - 1, 0))), t, kept)
        if ti.static(robot.staggered):
            if back == 0:
                for i in range(n.cell_rows):
                    g.x[i] = g.x[i] + share * robot.mask[i]
        kept += 1
        if kept == CHUNK or t == 0:
            largest = ti.max(largest, position_gradients(robot))
            if controlled:
                latest = ti.static(history.at(t + kept - 1))
                add_weight_gradients(robot, latest, history.stride, kept)
            kept = 0
    if ti.static(robot.physics_gradients):
        add_cotangent(robot, cotangents, 0)
        write_velocity_gradient(robot)
    return max_of(robot.simd, work.search_x, largest)


@ti.func
def position_gradients(robot: ti.template()):
    """The greatest gradients of 16 groups of positions."""
    g = ti.static(robot.work.g)
    largest = robot.simd.lanes(0.0)
    for i in range(robot.n.cell_rows):
        largest = ti.max(largest, ti.max(absolute(g.x[i]), absolute(g.y[i])))
    return largest


@ti.func
def write_velocity_gradient(robot: ti.template()):
    """The gradient with respect to the initial velocities."""
    g, velocity = ti.static(robot.work.g, robot.d_physics.velocity)
    for i in range(robot.n.cell_rows):
        gx, gy = g.vx[i], g.vy[i]
        if ti.static(robot.staggered):  # positions are half a step ahead
            gx, gy = gx + 0.5 * robot.dt * g.x[i], gy + 0.5 * robot.dt * g.y[i]
        velocity[i], velocity[robot.n.cell_rows + i] = gx, gy


@ti.func
def squared_norm(simd: ti.template(), g: ti.template(), rows, bias_gain):
    """The squared norm of the weights' gradient, in which the hidden bias counts `bias_gain` times."""
    square = simd.row(0.0)
    for i in range(rows):
        square += g.all.row[i] * g.all.row[i]
    bias = g.b1.row[0]
    square += (bias_gain - 1.0) * bias * bias
    return square.sum()


@ti.func
def update_weights(weights: ti.template(), g: ti.template(), square, rows, rule: ti.template()):
    """A step against the gradient with this squared norm, always of the same length (paper, Sect.
    Learning)."""
    step = rule.length / (ti.sqrt(square) + rule.min_gradient)
    bias = g.b1.row[0]
    for i in range(rows):
        weights.all.row[i] = weights.all.row[i] - step * g.all.row[i]
    weights.b1.row[0] = weights.b1.row[0] - (rule.bias_gain - 1.0) * step * bias
