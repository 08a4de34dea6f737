"""Contact of masses with the ground, forward and adjoint (paper, Sect. Ground contact model), 16 at a time.

With friction every mass remembers the segment below it (`Footing`): while it stays over that one, the ground
is a straight line and its height a product and a sum. Only where a mass has left it is the ground searched.
"""

from types import SimpleNamespace

from eldir.engine.compiler import ti

NO_CONTACT, NO_SLIP, FRICTION = range(3)
"""Kinds of ground."""
SEGMENT = 7
"""Values of a segment: see `functions`."""
FAR = 1e30
"""Beyond any ground [m]."""


def functions(kind: SimpleNamespace) -> SimpleNamespace:
    """Contact for one precision.

    `ground.segments` holds x0, end, slope, intercept, level and normal of segment i from 7 i on: the line
    slope x + intercept is what is hit, slope x + level the height (they differ only left of the released
    code's ground, docs/decisions/0001). A mass between x0 and end may remember it. The grid of cells of equal
    width says where to begin looking.
    """
    real, lanes, width = kind.real, kind.lanes, kind.width

    @ti.func
    def size(x):
        return ti.max(x, 0.0 - x)

    @ti.func
    def signed(x, sign):
        """x, or -x where the sign is negative."""
        return ti.select(sign < 0.0, 0.0 - x, x)

    @ti.func
    def landing(y, wy, law: ti.template(), level):
        """Without slip: 1 for those that land within the step, and when."""
        zero, one = lanes(0.0), lanes(1.0)
        hit = ti.select(y + law.dt * wy < level, ti.select(wy < -law.resting, one, zero), zero)
        toi = ti.select(hit > 0.5, (level - y) / ti.min(wy, -law.resting), lanes(law.dt))
        return hit, toi

    @ti.func
    def forget(under: ti.template(), body: ti.template(), i):
        """The i-th masses forget their segments: no x lies between 1 and -1, so they will search. Empty cells
        stay above a low plain."""
        under.start[i] = ti.select(body.mask[i] > 0.5, lanes(1.0), lanes(-FAR))
        under.end[i] = ti.select(body.mask[i] > 0.5, lanes(-1.0), lanes(FAR))
        under.slope[i], under.level[i] = lanes(0.0), lanes(-FAR)

    @ti.func
    def segment(ground: ti.template(), x):
        """The last segment that begins at or before x. The grid's first and last cell extend for ever."""
        c = ti.cast(ti.floor((x - ground.grid_from) * ground.cells_per_m), ti.i32) + 1
        s = ground.cell_segment[ti.max(ti.min(c, ground.cells - 1), 0)]
        while s < ground.last and x >= ground.segments[SEGMENT * (s + 1)]:
            s += 1
        return s

    @ti.func
    def remember(ground: ti.template(), s, under: ti.template(), k):
        for j, column in ti.static(enumerate(under)):
            column.each[k] = ground.segments[SEGMENT * s + j]

    @ti.func
    def astray(under: ti.template(), i, x):
        """1 for masses that would not be over the segments they remember, at x."""
        zero, one = lanes(0.0), lanes(1.0)
        return ti.select(x >= under.start[i], ti.select(x < under.end[i], zero, one), one)

    @ti.func
    def look(ground: ti.template(), work: ti.template(), i, x):
        """Makes masses remember the segments below x."""
        under = ti.static(work.under)
        if kind.any(astray(under, i, x)):
            work.asked[0] = x
            for j in range(width):
                k, at = width * i + j, work.asked.each[j]
                if not (at >= under.start.each[k] and at < under.end.each[k]):
                    remember(ground, segment(ground, at), under, k)

    @ti.func
    def height(under: ti.template(), i, x):
        return under.slope[i] * x + under.level[i]

    @ti.func
    def nearing(slope, intercept, nx, ny, x, y, wx, wy, law: ti.template()):
        """A line's signed distance, the speed along its normal, and when it is reached."""
        gap, speed = (y - slope * x - intercept) * ny, wx * nx + wy * ny
        return gap, speed, size(gap) / (size(speed) + law.tiny)

    @ti.func
    def first_hit(ground: ti.template(), x, y, wx, wy, law: ti.template()):
        """The segment that one mass reaches first, of those from x to x + dt w, or one that it does not."""
        s0, s1 = segment(ground, x), segment(ground, x + law.dt * wx)
        soonest, hit = law.dt, ti.min(s0, s1)
        for s in range(ti.min(s0, s1), ti.max(s0, s1) + 1):
            _, slope, intercept, _, nx, ny = [
                ground.segments[SEGMENT * s + j] for j in ti.static(range(1, 7))
            ]
            _, _, toi = nearing(slope, intercept, nx, ny, x, y, wx, wy, law)
            if toi < soonest:
                soonest, hit = toi, s
        return hit

    @ti.func
    def facing(
        ground: ti.template(), work: ti.template(), now: ti.template(), i, crossing, law: ti.template()
    ):
        """The lines that masses hit: those they remember, but in a step across a corner of the ground."""
        under, faced = ti.static(work.under, work.facing)
        slope, intercept, nx, ny = under.slope[i], under.intercept[i], under.nx[i], under.ny[i]
        if crossing:
            for j in range(width):
                k = width * i + j
                at = now.x.each[k]
                if at >= under.start.each[k] and at < under.end.each[k]:
                    for column, remembered in ti.static(zip(faced, under, strict=True)):
                        column.each[j] = remembered.each[k]
                else:
                    s = first_hit(ground, at, now.y.each[k], now.wx.each[k], now.wy.each[k], law)
                    remember(ground, s, faced, j)
            slope, intercept, nx, ny = faced.slope[0], faced.intercept[0], faced.nx[0], faced.ny[0]
        return slope, intercept, nx, ny

    @ti.func
    def slowed(under: ti.template(), i, wx, wy, law: ti.template()):
        """Friction takes so much of the speed across the ground from the one along, but no more than it has.

        Returns that speed, signed, and the two speeds. Along is the normal turned right.
        """
        nx, ny = under.nx[i], under.ny[i]
        along, across = wx * ny - wy * nx, wx * nx + wy * ny
        left = ti.max(size(along) - law.friction * size(across), lanes(0.0))
        return signed(left, along), along, across

    @ti.func
    def below(ground: ti.template(), work: ti.template(), i, px, py):
        """1 for masses that free flight to p would put below the ground. Looks for it where unclear."""
        zero, one = lanes(0.0), lanes(1.0)
        under = ti.static(work.under)
        low = ti.select(py < ground.top, astray(under, i, px), zero)
        hit = ti.select(py < height(under, i, px), one, low)
        if kind.any(hit):
            look(ground, work, i, px)
            hit = ti.select(py < height(under, i, px), one, zero)
        return hit

    @ti.func
    def slide(
        ground: ti.template(), work: ti.template(), now: ti.template(), after: ti.template(), i,
        law: ti.template(),
    ):  # fmt: skip
        """With friction: corrects what free flight made of the i-th 16 masses after dt."""
        under = ti.static(work.under)
        px, py = after.x[i], after.y[i]
        hit = below(ground, work, i, px, py)
        met = kind.any(hit)
        now.met.each[i] = ti.cast(met, real)
        if met:
            x, y, wx, wy = now.x[i], now.y[i], now.wx[i], now.wy[i]
            crossing = kind.any(ti.select(hit > 0.5, astray(under, i, x), lanes(0.0)))
            slope, intercept, nx, ny = facing(ground, work, now, i, crossing, law)
            toi = ti.min(nearing(slope, intercept, nx, ny, x, y, wx, wy, law)[2], law.dt)
            px = ti.select(hit > 0.5, x + toi * wx, px)
            if crossing:
                look(ground, work, i, px)
            speed = slowed(under, i, wx, wy, law)[0]
            vx, vy = speed * under.ny[i], speed * (0.0 - under.nx[i])
            px = ti.select(hit > 0.5, px + (law.dt - toi) * vx, px)
            look(ground, work, i, px)
            lifted = ti.max(y + toi * wy + (law.dt - toi) * vy, height(under, i, px))
            after.x[i], after.y[i] = px, ti.select(hit > 0.5, lifted, py)
            after.vx[i], after.vy[i] = ti.select(hit > 0.5, vx, wx), ti.select(hit > 0.5, vy, wy)

    @ti.func
    def slide_adjoint(
        ground: ti.template(), work: ti.template(), now: ti.template(), i, law: ti.template(),
        slopes: ti.template(),
    ):  # fmt: skip
        """Gradients with respect to x, w and friction, from those of position and velocity after the step."""
        g, under = ti.static(work.g, work.under)
        if now.met.each[i] > 0:
            zero, one = lanes(0.0), lanes(1.0)
            x, y, wx, wy = now.x[i], now.y[i], now.wx[i], now.wy[i]
            px, py = x + law.dt * wx, y + law.dt * wy
            look(ground, work, i, px)
            hit = ti.select(py < height(under, i, px), one, zero)
            crossing = kind.any(ti.select(hit > 0.5, astray(under, i, x), zero))
            slope, intercept, fx, fy = facing(ground, work, now, i, crossing, law)
            gap, approach, reached = nearing(slope, intercept, fx, fy, x, y, wx, wy, law)
            toi = ti.min(reached, law.dt)
            rest = law.dt - toi
            px = ti.select(hit > 0.5, x + toi * wx, px)
            if crossing:
                look(ground, work, i, px)
            nx, ny = under.nx[i], under.ny[i]
            speed, along, across = slowed(under, i, wx, wy, law)
            vx, vy = speed * ny, speed * (0.0 - nx)
            px = ti.select(hit > 0.5, px + rest * vx, px)
            py = y + toi * wy + rest * vy
            look(ground, work, i, px)
            lifted = py < height(under, i, px)
            gx, gy, gvx, gvy = g.x[i], g.y[i], g.vx[i], g.vy[i]
            gpx = ti.select(lifted, gx + under.slope[i] * gy, gx)
            gpy = ti.select(lifted, zero, gy)
            gwx, gwy = toi * gpx, toi * gpy
            # speed = |along| - friction |across|, where that is not negative
            onward = signed((gvx + rest * gpx) * ny - (gvy + rest * gpy) * nx, along)
            onward = ti.select(size(speed) > 0.0, onward, zero)
            if ti.static(law.physical):
                slopes.friction[0] = slopes.friction[0] - ti.select(hit > 0.5, onward * size(across), zero)
            gwx += onward * (signed(ny, along) - law.friction * signed(nx, across))
            gwy += onward * (signed(0.0 - nx, along) - law.friction * signed(ny, across))
            # toi = |gap| / |approach|, where that is not beyond the step
            g_gap = (gpx * (wx - vx) + gpy * (wy - vy)) / (size(approach) + law.tiny)
            g_gap = ti.select(reached < law.dt, g_gap, zero)
            nearer, faster = signed(g_gap, gap), signed(g_gap, approach) * toi
            g.x[i] = ti.select(hit > 0.5, gpx + nearer * fx, gx)
            g.y[i] = ti.select(hit > 0.5, gpy + nearer * fy, gy)
            g.wx[i] = ti.select(hit > 0.5, gwx - faster * fx, g.wx[i])
            g.wy[i] = ti.select(hit > 0.5, gwy - faster * fy, g.wy[i])

    return SimpleNamespace(landing=landing, forget=forget, slide=slide, slide_adjoint=slide_adjoint)
