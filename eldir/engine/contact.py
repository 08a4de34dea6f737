"""How a mass meets the ground, forward and adjoint (paper, Sect. Ground contact model)."""

from types import SimpleNamespace

from eldir.engine.runtime import start

ti = start()


def functions(real, v2):
    """The functions for one precision.

    The terrain is `ground[4 i ...]` = x0, slope, intercept, level of segment i: the line
    slope x + intercept is what is hit, slope x + level is the height (they differ only left of
    the released code's ground, see docs/decisions/0001).
    """

    @ti.func
    def segment(ground: ti.template(), count, x):
        """The last segment that begins at or before x."""
        low, high = 0, count
        while high - low > 1:
            middle = (low + high) // 2
            if x >= ground[4 * middle]:
                low = middle
            else:
                high = middle
        return low

    @ti.func
    def height(ground: ti.template(), s, x):
        return ground[4 * s + 1] * x + ground[4 * s + 3]

    @ti.func
    def normal(ground: ti.template(), s):
        m = ground[4 * s + 1]
        return v2(-m, 1) / ti.sqrt(1 + m * m)

    @ti.func
    def gap(ground: ti.template(), s, x):
        """Signed distance of x above the line of segment s."""
        m = ground[4 * s + 1]
        return (x[1] - m * x[0] - ground[4 * s + 2]) / ti.sqrt(1 + m * m)

    @ti.func
    def impact(ground: ti.template(), s0, s1, x, w, dt, tiny):
        """Time of impact over the segments between s0 and s1, at most dt, and the segment hit."""
        toi = dt
        hit = -1
        for s in range(ti.min(s0, s1), ti.max(s0, s1) + 1):
            t = abs(gap(ground, s, x)) / (abs(w.dot(normal(ground, s))) + tiny)
            if t < toi:
                toi = t
                hit = s
        return toi, hit

    @ti.func
    def friction(ground: ti.template(), count, top, x, w, dt, tiny):
        """Where a mass at x with velocity w is after dt, and its velocity then."""
        p = x + dt * w
        v = w
        if p[1] < top:
            s1 = segment(ground, count, p[0])
            if p[1] < height(ground, s1, p[0]):
                toi, _ = impact(ground, segment(ground, count, x[0]), s1, x, w, dt, tiny)
                p = x + toi * w
                n = normal(ground, segment(ground, count, p[0]))
                across = w.dot(n)
                along = w[0] * n[1] - w[1] * n[0]
                # Friction takes the lesser of the two speeds and never turns the mass around.
                slip = ti.max(abs(along) - abs(across), ti.cast(0, real))
                v = ti.select(along < 0, -slip, slip) * v2(n[1], -n[0])
                p += (dt - toi) * v
                s2 = segment(ground, count, p[0])
                p[1] = ti.max(p[1], height(ground, s2, p[0]))
        return p, v

    @ti.func
    def friction_adjoint(ground: ti.template(), count, top, x, w, dt, tiny, gp, gv):
        """Gradients with respect to x and w from those of the new position and velocity."""
        gx = gp
        gw = dt * gp + gv
        p = x + dt * w
        if p[1] < top:
            s1 = segment(ground, count, p[0])
            if p[1] < height(ground, s1, p[0]):
                toi, hit = impact(ground, segment(ground, count, x[0]), s1, x, w, dt, tiny)
                p = x + toi * w
                n = normal(ground, segment(ground, count, p[0]))
                tangent = v2(n[1], -n[0])
                across = w.dot(n)
                along = w.dot(tangent)
                slip = ti.max(abs(along) - abs(across), ti.cast(0, real))
                v = ti.select(along < 0, -slip, slip) * tangent
                p += (dt - toi) * v
                s2 = segment(ground, count, p[0])
                g = gp
                if p[1] < height(ground, s2, p[0]):  # lifted onto the ground
                    g = v2(gp[0] + ground[4 * s2 + 1] * gp[1], 0)
                gslip = (gv + (dt - toi) * g).dot(tangent)
                gw = toi * g
                if slip > 0:  # d|across| = sign(across) n, with the sign of the motion along
                    opposed = ti.select(across * along < 0, -gslip, gslip)
                    gw += gslip * tangent - opposed * n
                gx = g
                if hit >= 0:
                    m = normal(ground, hit)
                    gtoi = g.dot(w - v)
                    nearing = w.dot(m)
                    over = gtoi / (abs(nearing) + tiny)
                    gx += ti.select(gap(ground, hit, x) < 0, -over, over) * m
                    gw += ti.select(nearing < 0, over, -over) * toi * m
        return gx, gw

    return SimpleNamespace(friction=friction, friction_adjoint=friction_adjoint)
