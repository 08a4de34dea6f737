"""Springs: Hooke's law with a rest length that a motor changes (paper, Sect. Robot simulation)."""

from types import SimpleNamespace

import taichi as ti


def functions(kind: SimpleNamespace) -> SimpleNamespace:
    """Forward and adjoint for one precision."""
    pair, gather = kind.pair, kind.gather

    @ti.func
    def across(column: ti.template(), body: ti.template(), s):
        """Values at the ends a minus those at the ends b, of the s-th 16 springs."""
        return gather(column, body.a, s) - gather(column, body.b, s)

    @ti.func
    def to_ends(body: ti.template(), work: ti.template()):
        """Sum f over the springs of every mass: + at its ends a, - at its ends b."""
        kind.fill(work.ends, 2 * body.n.mass_rows, 0.0)
        for s in range(body.n.springs):
            f = pair([work.fx.each[s], work.fy.each[s]])
            a, b = body.a.each[s], body.b.each[s]
            work.ends.pair[a] = work.ends.pair[a] + f
            work.ends.pair[b] = work.ends.pair[b] - f

    @ti.func
    def push(now: ti.template(), body: ti.template(), law: ti.template(), work: ti.template()):
        """Impulses on the masses: f = dt k (target - l) / l d."""
        for s in range(body.n.spring_rows):
            dx, dy = across(now.x, body, s), across(now.y, body, s)
            length = ti.sqrt(dx * dx + dy * dy) + law.softening
            target = body.rest_length[s]
            if 16 * s < body.n.motors:
                target *= 1.0 + law.actuation * now.action[s]
            strength = law.stiffness_dt * (target / length - 1.0)
            work.fx[s] = strength * dx
            work.fy[s] = strength * dy
            now.dx[s] = dx
            now.dy[s] = dy
        to_ends(body, work)

    @ti.func
    def push_adjoint(
        now: ti.template(), body: ti.template(), law: ti.template(), work: ti.template(), delta: ti.template()
    ):
        """From the gradient of w to those of x and, before tanh, of the activations (`delta`)."""
        g = ti.static(work.g)
        for s in range(body.n.spring_rows):
            dx, dy = now.dx[s], now.dy[s]
            gfx, gfy = across(g.wx, body, s), across(g.wy, body, s)
            distance = ti.max(ti.sqrt(dx * dx + dy * dy), law.tiny)
            length = distance + law.softening
            per_both = 1.0 / (distance * length)
            per_length = per_both * distance
            along = (gfx * dx + gfy * dy) * law.stiffness_dt * per_length
            target = body.rest_length[s]
            if 16 * s < body.n.motors:
                action = now.action[s]
                delta[s] = along * target * law.actuation * (1.0 - action * action)
                target *= 1.0 + law.actuation * action
            strength = law.stiffness_dt * (target * per_length - 1.0)
            lengthening = along * target * per_both
            work.fx[s] = strength * gfx - lengthening * dx
            work.fy[s] = strength * gfy - lengthening * dy
        for k in range(body.n.motors, body.n.padded_motors):
            delta.each[k] = 0  # passive springs beside the motors, and what another robot left here
        to_ends(body, work)
        for i in range(body.n.mass_rows):
            f0, f1 = work.ends[2 * i], work.ends[2 * i + 1]
            g.x[i] = g.x[i] + kind.evens(f0, f1)
            g.y[i] = g.y[i] + kind.odds(f0, f1)

    return SimpleNamespace(push=push, push_adjoint=push_adjoint)
