"""Masses: damping, gravity and impulses, then free flight or ground (paper, Sect. Simulation)."""

from types import SimpleNamespace

from eldir.engine.compiler import ti
from eldir.engine.kernels.contact import FRICTION, NO_SLIP


def functions(kind: SimpleNamespace, contact: SimpleNamespace, spring: SimpleNamespace) -> SimpleNamespace:
    """Forward and adjoint for one precision."""
    lanes = kind.lanes

    @ti.func
    def advance_row(
        now: ti.template(), after: ti.template(), body: ti.template(), law: ti.template(),
        ground: ti.template(), work: ti.template(), i,
    ):  # fmt: skip
        """The i-th masses after a step, in free flight or, without slip, where they land; returns their
        greatest speeds."""
        fx, fy = spring.total(work, body, i)
        wx = law.decay * now.vx[i] + fx
        wy = law.decay * now.vy[i] + fy + law.gravity_dt * body.mask[i]
        now.wx[i] = wx
        now.wy[i] = wy
        hit, toi = lanes(0.0), lanes(law.dt)
        if ti.static(ground.contact == NO_SLIP):
            hit, toi = contact.landing(now.y[i], wy, law, ground.level)
        after.x[i] = now.x[i] + toi * wx
        after.y[i] = now.y[i] + toi * wy
        after.vx[i] = wx * (1.0 - hit)
        after.vy[i] = wy * (1.0 - hit)
        return ti.max(ti.max(wx, 0.0 - wx), ti.max(wy, 0.0 - wy))

    @ti.func
    def advance(
        now: ti.template(), after: ti.template(), body: ti.template(), law: ti.template(),
        ground: ti.template(), work: ti.template(),
    ):  # fmt: skip
        """Computes the state after a step from the one before; returns the greatest speeds."""
        fastest = lanes(0.0)
        for i in range(body.n.cell_rows):
            fastest = ti.max(fastest, advance_row(now, after, body, law, ground, work, i))
        if ti.static(ground.contact == FRICTION):  # a loop of its own: the one above stays free of branches
            for i in range(body.n.cell_rows):
                contact.slide(ground, work, now, after, i, law)
        return fastest

    @ti.func
    def advance_adjoint_row(
        now: ti.template(), law: ti.template(), ground: ti.template(), g: ti.template(), i
    ):
        """The gradients of the i-th masses' x and w, in free flight or without slip."""
        wx, wy = now.wx[i], now.wy[i]
        gx, gy = g.x[i], g.y[i]
        hit, toi = lanes(0.0), lanes(law.dt)
        if ti.static(ground.contact == NO_SLIP):
            hit, toi = contact.landing(now.y[i], wy, law, ground.level)
        gwx = toi * gx + (1.0 - hit) * g.vx[i]
        gwy = toi * gy + (1.0 - hit) * g.vy[i]
        if ti.static(ground.contact == NO_SLIP):
            # toi = (level - y) / wy where the mass lands, else constant.
            later = (gx * wx + gy * wy) * hit / ti.min(wy, -law.resting)
            g.y[i] = gy - later
            gwy = gwy - later * toi
        g.wx[i] = gwx
        g.wy[i] = gwy

    @ti.func
    def advance_adjoint(
        now: ti.template(), body: ti.template(), law: ti.template(), ground: ti.template(),
        work: ti.template(), slopes: ti.template(),
    ):  # fmt: skip
        """Propagates the gradients of the state after a step to those of x, w and v before it."""
        g = ti.static(work.g)
        for i in range(body.n.cell_rows):
            advance_adjoint_row(now, law, ground, g, i)
        if ti.static(ground.contact == FRICTION):
            for i in range(body.n.cell_rows):
                contact.slide_adjoint(ground, work, now, i, law, slopes)
        for i in range(body.n.cell_rows):
            if ti.static(law.physical):
                slopes.decay[0] = slopes.decay[0] + g.wx[i] * now.vx[i] + g.wy[i] * now.vy[i]
                slopes.gravity_dt[0] = slopes.gravity_dt[0] + g.wy[i] * body.mask[i]
            g.vx[i] = law.decay * g.wx[i]
            g.vy[i] = law.decay * g.wy[i]

    return SimpleNamespace(
        advance=advance, advance_row=advance_row,
        advance_adjoint=advance_adjoint, advance_adjoint_row=advance_adjoint_row,
    )  # fmt: skip
