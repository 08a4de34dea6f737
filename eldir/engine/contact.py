"""How a mass meets the ground, forward and adjoint (paper, Sect. Ground contact model)."""

from types import SimpleNamespace

import taichi as ti

NO_CONTACT, NO_SLIP, FRICTION = range(3)
"""Kinds of ground."""
WINDOW = 64
"""Cells whose ground is bounded together: a robot stands on fewer."""


def functions(kind: SimpleNamespace) -> SimpleNamespace:
    """For one precision.

    `ground.segments` holds x0, slope, intercept, level and normal of segment i from 6 i on: the line
    slope x + intercept is what is hit, slope x + level the height (they differ only left of the released
    code's ground, docs/decisions/0001). The grid of cells of equal width says where to begin looking.
    """
    real, pair, lanes = kind.real, kind.pair, kind.lanes

    @ti.func
    def landing(y, wy, law: ti.template(), level):
        """Without slip, 16 masses: 1 for those that land within the step, and when."""
        zero, one = lanes(0.0), lanes(1.0)
        hit = ti.select(y + law.dt * wy < level, ti.select(wy < -law.resting, one, zero), zero)
        toi = ti.select(hit > 0.5, (level - y) / ti.min(wy, -law.resting), lanes(law.dt))
        return hit, toi

    @ti.func
    def cell(ground: ti.template(), x):
        """The cells' first and last extend for ever."""
        c = ti.cast(ti.floor((x - ground.grid_from) * ground.cells_per_m), ti.i32) + 1
        return ti.max(ti.min(c, ground.cells - 1), 0)

    @ti.func
    def bound(ground: ti.template(), x):
        """No ground near x is higher than this."""
        return ground.cell_top[cell(ground, x)]

    @ti.func
    def highest(ground: ti.template(), left, right):
        """No ground from left to right is higher than this."""
        c, last = cell(ground, left), cell(ground, right)
        top = ground.cells_top[c]
        while c + WINDOW <= last:
            c += WINDOW
            top = ti.max(top, ground.cells_top[c])
        return top

    @ti.func
    def segment(ground: ti.template(), x):
        """The last segment that begins at or before x."""
        s = ground.cell_segment[cell(ground, x)]
        while x >= ground.segments[6 * s + 6]:
            s += 1
        return s

    @ti.func
    def height(ground: ti.template(), x):
        s = segment(ground, x)
        return ground.segments[6 * s + 1] * x + ground.segments[6 * s + 3]

    @ti.func
    def normal(ground: ti.template(), s):
        return pair(ground.segments[6 * s + 4], ground.segments[6 * s + 5])

    @ti.func
    def gap(ground: ti.template(), s, x):
        """Signed distance of x above the line of segment s."""
        m = ground.segments[6 * s + 1]
        return (x[1] - m * x[0] - ground.segments[6 * s + 2]) * ground.segments[6 * s + 5]

    @ti.func
    def impact(ground: ti.template(), x, w, law: ti.template()):
        """Time of impact over the segments from x to x + dt w, at most dt, and the segment hit or -1."""
        s0, s1 = segment(ground, x[0]), segment(ground, x[0] + law.dt * w[0])
        toi, hit = law.dt, -1
        for s in range(ti.min(s0, s1), ti.max(s0, s1) + 1):
            t = abs(gap(ground, s, x)) / (abs(w.dot(normal(ground, s))) + law.tiny)
            if t < toi:
                toi, hit = t, s
        return toi, hit

    @ti.func
    def slowed(n, w, friction):
        """Friction takes so much of the speed across the ground from the one along, but no more than it has.

        Returns the direction of motion along the ground, the speed left, and the two speeds.
        """
        forward = pair(n[1], -n[0])
        along, across = w.dot(forward), w.dot(n)
        direction = ti.select(along < 0, 0.0 - forward, forward)
        return direction, ti.max(abs(along) - friction * abs(across), ti.cast(0, real)), across

    @ti.func
    def slide(ground: ti.template(), x, w, law: ti.template()):
        """With friction: where a mass at x with velocity w is after dt, and its velocity then."""
        p, v = x + law.dt * w, w
        if p[1] < height(ground, p[0]):
            toi, _ = impact(ground, x, w, law)
            p = x + toi * w
            direction, speed, _ = slowed(normal(ground, segment(ground, p[0])), w, law.friction)
            v = speed * direction
            p += (law.dt - toi) * v
            p[1] = ti.max(p[1], height(ground, p[0]))
        return p, v

    @ti.func
    def slide_adjoint(ground: ti.template(), x, w, law: ti.template(), gp, gv):
        """Gradients with respect to x, w and friction from those of the new position and velocity."""
        gx, gw, g_friction = gp, law.dt * gp + gv, ti.cast(0, real)
        p = x + law.dt * w
        if p[1] < height(ground, p[0]):
            toi, hit = impact(ground, x, w, law)
            p = x + toi * w
            n = normal(ground, segment(ground, p[0]))
            direction, speed, across = slowed(n, w, law.friction)
            v = speed * direction
            p += (law.dt - toi) * v
            if p[1] < height(ground, p[0]):  # lifted onto the ground
                gp = pair(gp[0] + ground.segments[6 * segment(ground, p[0]) + 1] * gp[1], 0)
            gx, gw = gp, toi * gp
            if speed > 0:  # speed = |along| - friction |across|
                g_speed = (gv + (law.dt - toi) * gp).dot(direction)
                g_friction = 0.0 - g_speed * abs(across)
                gw += g_speed * (direction - law.friction * ti.select(across < 0, 0.0 - n, n))
            if hit >= 0:  # toi = |gap| / |w.n|
                facing = normal(ground, hit)
                nearing = w.dot(facing)
                g_gap = gp.dot(w - v) / (abs(nearing) + law.tiny)
                gx += ti.select(gap(ground, hit, x) < 0, -g_gap, g_gap) * facing
                gw = gw - ti.select(nearing < 0, -g_gap, g_gap) * toi * facing
        return gx, gw, g_friction

    return SimpleNamespace(
        landing=landing, bound=bound, highest=highest, slide=slide, slide_adjoint=slide_adjoint
    )
