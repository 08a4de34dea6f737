"""Masses: damping, gravity and impulses, then free flight or ground (paper, Sect. Robot simulation)."""

from types import SimpleNamespace

import taichi as ti

from eldir.engine.contact import FRICTION, NO_SLIP


def functions(kind: SimpleNamespace, contact: SimpleNamespace, spring: SimpleNamespace) -> SimpleNamespace:
    """Forward and adjoint for one precision."""
    pair, lanes = kind.pair, kind.lanes

    @ti.func
    def highest_below(x: ti.template(), body: ti.template(), ground: ti.template()):
        """No ground under any mass is higher than this."""
        left, right = lanes(1e30), lanes(-1e30)
        for i in range(body.n.cell_rows):
            left = ti.select(body.mask[i] > 0.5, ti.min(left, x[i]), left)
            right = ti.select(body.mask[i] > 0.5, ti.max(right, x[i]), right)
        return contact.highest(ground, left.min(), right.max())

    @ti.func
    def touch(
        k, now: ti.template(), after: ti.template(), body: ti.template(), law: ti.template(),
        ground: ti.template(),
    ):  # fmt: skip
        """One mass, if it meets the ground."""
        if body.mask.each[k] > 0 and after.y.each[k] < contact.bound(ground, after.x.each[k]):
            x, w = pair([now.x.each[k], now.y.each[k]]), pair([now.wx.each[k], now.wy.each[k]])
            p, v = contact.slide(ground, x, w, law)
            after.x.each[k], after.y.each[k] = p[0], p[1]
            after.vx.each[k], after.vy.each[k] = v[0], v[1]

    @ti.func
    def touch_adjoint(
        k,
        now: ti.template(),
        body: ti.template(),
        law: ti.template(),
        ground: ti.template(),
        g: ti.template(),
        slopes: ti.template(),
    ):
        x, w = pair([now.x.each[k], now.y.each[k]]), pair([now.wx.each[k], now.wy.each[k]])
        p = x + law.dt * w
        if body.mask.each[k] > 0 and p[1] < contact.bound(ground, p[0]):
            gp, gv = pair([g.x.each[k], g.y.each[k]]), pair([g.vx.each[k], g.vy.each[k]])
            gx, gw, g_friction = contact.slide_adjoint(ground, x, w, law, gp, gv)
            g.x.each[k], g.y.each[k] = gx[0], gx[1]
            g.wx.each[k], g.wy.each[k] = gw[0], gw[1]
            if ti.static(law.physical):
                slopes.friction.each[0] = slopes.friction.each[0] + g_friction

    @ti.func
    def advance(
        now: ti.template(),
        after: ti.template(),
        body: ti.template(),
        law: ti.template(),
        ground: ti.template(),
        work: ti.template(),
    ):
        """From the state before a step to the one after it; returns the greatest speeds."""
        fastest = lanes(0.0)
        for i in range(body.n.cell_rows):
            fx, fy = spring.total(work, body, i)
            wx = law.decay * now.vx[i] + fx
            wy = law.decay * now.vy[i] + fy + law.gravity_dt * body.mask[i]
            fastest = ti.max(fastest, ti.max(ti.max(wx, 0.0 - wx), ti.max(wy, 0.0 - wy)))
            now.wx[i] = wx
            now.wy[i] = wy
            hit, toi = lanes(0.0), lanes(law.dt)
            if ti.static(ground.contact == NO_SLIP):
                hit, toi = contact.landing(now.y[i], wy, law, ground.level)
            after.x[i] = now.x[i] + toi * wx
            after.y[i] = now.y[i] + toi * wy
            after.vx[i] = wx * (1.0 - hit)
            after.vy[i] = wy * (1.0 - hit)
        if ti.static(ground.contact == FRICTION):
            top = highest_below(after.x, body, ground)
            for i in range(body.n.cell_rows):
                if ti.select(after.y[i] < top, body.mask[i], lanes(0.0)).sum() > 0:
                    for k in range(16 * i, 16 * i + 16):
                        touch(k, now, after, body, law, ground)
        return fastest

    @ti.func
    def advance_adjoint(
        now: ti.template(),
        body: ti.template(),
        law: ti.template(),
        ground: ti.template(),
        work: ti.template(),
        slopes: ti.template(),
    ):
        """From the gradients of the state after a step to those of x, w and v before it."""
        g = ti.static(work.g)
        for i in range(body.n.cell_rows):
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
        if ti.static(ground.contact == FRICTION):
            for i in range(body.n.cell_rows):
                work.ahead_x[i] = now.x[i] + law.dt * now.wx[i]
            top = highest_below(work.ahead_x, body, ground)
            for i in range(body.n.cell_rows):
                y = now.y[i] + law.dt * now.wy[i]
                if ti.select(y < top, body.mask[i], lanes(0.0)).sum() > 0:
                    for k in range(16 * i, 16 * i + 16):
                        touch_adjoint(k, now, body, law, ground, g, slopes)
        for i in range(body.n.cell_rows):
            if ti.static(law.physical):
                slopes.decay[0] = slopes.decay[0] + g.wx[i] * now.vx[i] + g.wy[i] * now.vy[i]
                slopes.gravity_dt[0] = slopes.gravity_dt[0] + g.wy[i] * body.mask[i]
            g.vx[i] = law.decay * g.wx[i]
            g.vy[i] = law.decay * g.wy[i]

    return SimpleNamespace(advance=advance, advance_adjoint=advance_adjoint)
