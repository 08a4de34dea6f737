"""Rollout, reverse sweep and update of one robot: the parts of `learning_kernel` that step through time."""

from types import SimpleNamespace

from eldir.engine.compiler import ti
from eldir.engine.kernels import contact, controller, masses, springs
from eldir.engine.kernels.layout import CHUNK


def functions(kind: SimpleNamespace) -> SimpleNamespace:
    """Forward, adjoint and update for one precision."""
    lanes, row = kind.lanes, kind.row
    spring, brain = springs.functions(kind), controller.functions(kind)
    touch = contact.functions(kind)
    mass = masses.functions(kind, touch, spring)

    @ti.func
    def rollout(
        history: ti.template(), body: ti.template(), law: ti.template(), ground: ti.template(),
        weights: ti.template(), work: ti.template(), steps,
    ):  # fmt: skip
        """Simulates all steps; returns the step at which the robot blew up, or -1."""
        first = ti.static(history.at(0))
        for i in range(body.n.cell_rows):
            x, y = body.start[i], body.start[body.n.cell_rows + i]
            vx, vy = body.velocity[i], body.velocity[body.n.cell_rows + i]
            if ti.static(law.staggered):
                x, y = x + 0.5 * law.dt * vx, y + 0.5 * law.dt * vy
            first.x[i], first.y[i] = x, y
            first.vx[i], first.vy[i] = vx, vy
        if ti.static(ground.contact == contact.FRICTION):
            for i in range(body.n.cell_rows):
                touch.forget(work.under, body, i)
        blown = -1
        for t in range(steps):
            now = ti.static(history.at(t))
            after = ti.static(history.at(t + 1))
            if body.n.motors > 0 or law.controlling:
                brain.act(now, ti.static(history.at(ti.max(t - 1, 0))), body, law, weights, t, work)
            spring.push(now, body, law, work)
            fastest = mass.advance(now, after, body, law, ground, work)
            if blown < 0 and not (fastest.sum() < 1e6):
                blown = t
                if law.stopping:
                    break
        return blown

    @ti.func
    def loss_of(history: ti.template(), body: ti.template(), law: ti.template(), steps):
        """Minus the mean forward displacement."""
        last, before = ti.static(history.at(steps), history.at(steps - 1))
        forward = lanes(0.0)
        for i in range(body.n.cell_rows):
            forward += last.x[i] - body.start[i]
            if ti.static(law.staggered):
                forward += 0.5 * (before.x[i] - last.x[i])
        return -forward.sum() * body.per_mass

    @ti.func
    def seed(g: ti.template(), body: ti.template(), share):
        """The gradient of the loss with respect to the state in which a window ends."""
        for i in range(body.n.cell_rows):
            g.x[i] = share * body.mask[i]
            g.y[i], g.vx[i], g.vy[i] = lanes(0.0), lanes(0.0), lanes(0.0)

    @ti.func
    def add_cotangent(g: ti.template(), body: ti.template(), wanted: ti.template(), t):
        """Adds the given cotangent of the positions of state t to their gradient."""
        if wanted.given:
            rows = body.n.cell_rows
            for i in range(rows):
                g.x[i] = g.x[i] + wanted.positions[2 * rows * t + i]
                g.y[i] = g.y[i] + wanted.positions[2 * rows * t + rows + i]

    @ti.func
    def reverse(
        history: ti.template(), body: ti.template(), law: ti.template(), ground: ti.template(),
        weights: ti.template(), work: ti.template(), slopes: ti.template(), wanted: ti.template(),
        steps, window,
    ):  # fmt: skip
        """Writes the gradient of the loss with respect to the weights into `work.g_weights` and, if
        requested, with respect to physics into `slopes`. With a window, the gradient is that of the
        displacements in all windows, each traced back to its own beginning only."""
        g = ti.static(work.g)
        acting = body.n.motors > 0 or law.controlling
        for i in range(body.n.weight_rows):
            work.g_weights.all.row[i] = row(0.0)
        share = -body.per_mass * (0.5 if ti.static(law.staggered) else 1.0)
        if ti.static(law.physical):
            kind.fill(slopes.stiffness_dt, body.n.slope_values >> 4, 0.0)
            share *= ti.select(wanted.given, 0.0, 1.0)
        seed(g, body, share)
        brain.begin_adjoint(body, work)
        kept = 0
        for back in range(steps):
            t = steps - 1 - back
            if back > 0 and (t + 1) % window == 0:
                seed(g, body, share)
            if ti.static(law.physical):
                add_cotangent(g, body, wanted, t + 1)
            now = ti.static(history.at(t))
            mass.advance_adjoint(now, body, law, ground, work, slopes)
            delta = ti.static(work.action_deltas + kept * body.n.padded_motors)
            spring.push_adjoint(now, body, law, work, slopes, delta)
            if acting:
                earlier = ti.static(history.at(ti.max(t - 1, 0)))
                brain.act_adjoint(now, earlier, body, law, weights, t, work, kept)
            if ti.static(law.staggered):
                if back == 0:
                    for i in range(body.n.cell_rows):
                        g.x[i] = g.x[i] + share * body.mask[i]
            kept += 1
            if kept == CHUNK or t == 0:
                if acting:
                    latest = ti.static(history.at(t + kept - 1))
                    brain.add_chunk(latest, history.stride, body, law, work, kept)
                kept = 0
        if ti.static(law.physical):
            add_cotangent(g, body, wanted, 0)
            for i in range(body.n.cell_rows):
                gx, gy = g.vx[i], g.vy[i]
                if ti.static(law.staggered):  # positions are half a step ahead
                    gx, gy = gx + 0.5 * law.dt * g.x[i], gy + 0.5 * law.dt * g.y[i]
                slopes.velocity[i], slopes.velocity[body.n.cell_rows + i] = gx, gy

    @ti.func
    def update(weights: ti.template(), g: ti.template(), rows, learning: ti.template()):
        """Against the gradient, always by the same length (paper, Sect. Learning)."""
        square = row(0.0)
        for i in range(rows):
            square += g.all.row[i] * g.all.row[i]
        bias = g.b1.row[0]
        square += (learning.bias_gain - 1.0) * bias * bias
        step = learning.length / (ti.sqrt(square.sum()) + learning.least_gradient)
        for i in range(rows):
            weights.all.row[i] = weights.all.row[i] - step * g.all.row[i]
        weights.b1.row[0] = weights.b1.row[0] - (learning.bias_gain - 1.0) * step * bias

    return SimpleNamespace(
        prepare_springs=spring.prepare, prepare_controller=brain.prepare, rollout=rollout, loss_of=loss_of,
        reverse=reverse, update=update,
    )  # fmt: skip
