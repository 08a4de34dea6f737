"""The kernel of the closed-loop robots: a queue of robots over workers, each robot simulated, differentiated
and taught in one go.

Everything a worker touches lies in its own workspace, so results depend neither on the number of threads nor
on which robots are in the queue. Whether to go backward or to record is decided once for each robot, not
compiled in. One code for all cases means that a rollout shows, to the last bit, what was learned.
"""

from collections.abc import Callable
from functools import cache

from eldir.engine.compiler import ti
from eldir.engine.kernels import layout, rollout, views
from eldir.engine.kernels.layout import OWN
from eldir.engine.kernels.learning_launch import LearningLaunch
from eldir.engine.kernels.vectors import vectors
from eldir.engine.launch import argument_types, kernel_of


@cache
def learning_kernel(precision: str) -> Callable[[LearningLaunch], None]:
    """The kernel for 'f32' or 'f64'."""
    kind = vectors(precision)
    real = kind.real
    robot = rollout.functions(kind)

    @ti.func
    def teach(
        launch: ti.template(), r, at: ti.template(), body: ti.template(), law: ti.template(),
        weights: ti.template(), mine: ti.template(),
    ):  # fmt: skip
        """Rollouts, gradients and updates of one robot; returns the step at which it blew up, or -1."""
        settings = ti.static(launch.settings)
        ground = ti.static(views.ground_of(launch))
        slopes = ti.static(views.slopes_of(launch, body.n, at))
        wanted = ti.static(views.cotangents_of(launch, at))
        g_weights = ti.static(mine.scratch.g_weights)
        iterations, rows = settings.iterations, body.n.weight_rows
        acting = body.n.motors > 0 or settings.controlling
        least = ti.cast(0, real)
        blown = -1
        for i in range(iterations + 1):
            if acting:
                robot.prepare_controller(body, law, weights, mine.scratch)
            blown = robot.rollout(mine.history, body, law, ground, weights, mine.scratch, settings.steps)
            if blown >= 0:
                break
            loss = robot.loss_of(mine.history, body, law, settings.steps)
            launch.losses[r * (iterations + 1) + i] = loss
            if settings.backward:
                if iterations > 0 and (i == 0 or loss < least):
                    least = loss
                    keep(launch.best, at, weights, rows)
                if (acting or ti.static(settings.physical)) and (i < iterations or iterations == 0):
                    robot.reverse(
                        mine.history, body, law, ground, weights, mine.scratch, slopes, wanted,
                        settings.steps, settings.window,
                    )  # fmt: skip
                    if iterations > 0:
                        robot.update(weights, g_weights, rows, ti.static(launch.rule))
                    else:  # the gradient is what was asked for
                        keep(launch.best, at, g_weights, rows)
        return blown

    @ti.func
    def keep(best: ti.template(), at: ti.template(), weights: ti.template(), rows):
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
    def work(worker, launch: ti.template()):
        while True:
            r = ti.atomic_add(launch.queue[0], 1)
            if r >= launch.robots:
                break
            decay = launch.arrays.own[OWN * r]
            gravity_dt, friction = launch.arrays.own[OWN * r + 1], launch.arrays.own[OWN * r + 2]
            law = ti.static(views.law_of(launch, decay, gravity_dt, friction))
            at = ti.static(layout.place(launch.places, r))
            n = ti.static(layout.size(at.masses, at.motors, at.cells, at.reach))
            per_mass = ti.cast(1, real) / n.masses
            body = ti.static(views.robot_of(launch, n, per_mass, at))
            mine = ti.static(views.workspace_of(launch, worker, n, r))
            weights = ti.static(views.weights_of(launch, n, at))
            robot.prepare_springs(body, mine.scratch)
            launch.status[r] = teach(launch, r, at, body, law, weights, mine)
            if launch.settings.recording:
                write_states(launch, at, n, mine.history)

    return kernel_of(LearningLaunch, argument_types(real), work)
