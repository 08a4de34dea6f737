"""Contact of masses with the ground, forward and adjoint (paper, Sect. Ground contact model), 16 at a time.

With friction every mass remembers the segment below it (`GroundSegments`): while it stays over that one, the
ground is a straight line and its height a product and a sum. Only where a mass has left it is the ground
searched.

`ground.segments` holds x0, end, slope, intercept, level and normal of segment i from 7 i on: the line
slope x + intercept is what is hit, slope x + level the height (they differ only left of the released code's
ground, docs/decisions/0001). A mass between x0 and end may remember it. The grid of cells of equal width says
where a search begins.
"""

from eldir.engine.compiler import ti

NO_CONTACT, NO_SLIP, FRICTION = range(3)
"""Contact models."""
SEGMENT_VALUES = 7
"""Values of a segment, see above."""
INFINITY = 1e30
"""Beyond any ground [m]."""


@ti.func
def absolute(x):
    return ti.max(x, 0.0 - x)


@ti.func
def apply_sign(x, sign):
    """x, or -x where the sign is negative."""
    return ti.select(sign < 0.0, 0.0 - x, x)


@ti.func
def no_slip_impact(robot: ti.template(), y, wy, level):
    """Without slip: 1 for masses that land within the step, and their time of impact."""
    zero, one = robot.simd.lanes(0.0), robot.simd.lanes(1.0)
    hit = ti.select(y + robot.dt * wy < level, ti.select(wy < -robot.min_landing_speed, one, zero), zero)
    toi = ti.select(hit > 0.5, (level - y) / ti.min(wy, -robot.min_landing_speed), robot.simd.lanes(robot.dt))
    return hit, toi


@ti.func
def reset_segments(robot: ti.template(), below: ti.template(), i):
    """The i-th masses forget their segments: no x lies between 1 and -1, so they will search. Empty cells
    stay above a low plain."""
    simd = ti.static(robot.simd)
    below.start[i] = ti.select(robot.mask[i] > 0.5, simd.lanes(1.0), simd.lanes(-INFINITY))
    below.end[i] = ti.select(robot.mask[i] > 0.5, simd.lanes(-1.0), simd.lanes(INFINITY))
    below.slope[i], below.level[i] = simd.lanes(0.0), simd.lanes(-INFINITY)


@ti.func
def find_segment(ground: ti.template(), x):
    """The last segment that begins at or before x. The grid's first and last cell extend to infinity."""
    c = ti.cast(ti.floor((x - ground.grid_start) * ground.cells_per_m), ti.i32) + 1
    s = ground.cell_segment[ti.max(ti.min(c, ground.cells - 1), 0)]
    while s < ground.last_segment and x >= ground.segments[SEGMENT_VALUES * (s + 1)]:
        s += 1
    return s


@ti.func
def store_segment(ground: ti.template(), s, segments: ti.template(), k):
    for j, column in ti.static(enumerate(segments)):
        column.each[k] = ground.segments[SEGMENT_VALUES * s + j]


@ti.func
def is_outside(robot: ti.template(), below: ti.template(), i, x):
    """1 for masses that would not be over the segments they remember, at x."""
    zero, one = robot.simd.lanes(0.0), robot.simd.lanes(1.0)
    return ti.select(x >= below.start[i], ti.select(x < below.end[i], zero, one), one)


@ti.func
def update_segments(robot: ti.template(), work: ti.template(), i, x):
    """Makes masses remember the segments below x."""
    below, ground = ti.static(work.segments_below, robot.ground)
    if robot.simd.any_positive(is_outside(robot, below, i, x)):
        work.search_x[0] = x
        for j in range(robot.simd.width):
            k, at = robot.simd.width * i + j, work.search_x.each[j]
            if not (at >= below.start.each[k] and at < below.end.each[k]):
                store_segment(ground, find_segment(ground, at), below, k)


@ti.func
def ground_height(below: ti.template(), i, x):
    return below.slope[i] * x + below.level[i]


@ti.func
def approach(robot: ti.template(), slope, intercept, nx, ny, x, y, wx, wy):
    """A line's signed distance, the speed along its normal, and the time of impact."""
    gap, speed = (y - slope * x - intercept) * ny, wx * nx + wy * ny
    return gap, speed, absolute(gap) / (absolute(speed) + robot.epsilon)


@ti.func
def first_segment_hit(robot: ti.template(), x, y, wx, wy):
    """The segment that one mass hits first, of those from x to x + dt w, or one that it does not hit."""
    ground = ti.static(robot.ground)
    s0, s1 = find_segment(ground, x), find_segment(ground, x + robot.dt * wx)
    min_toi, hit = robot.dt, ti.min(s0, s1)
    for s in range(ti.min(s0, s1), ti.max(s0, s1) + 1):
        _, slope, intercept, _, nx, ny = [
            ground.segments[SEGMENT_VALUES * s + j] for j in ti.static(range(1, 7))
        ]
        _, _, toi = approach(robot, slope, intercept, nx, ny, x, y, wx, wy)
        if toi < min_toi:
            min_toi, hit = toi, s
    return hit


@ti.func
def lines_hit(robot: ti.template(), work: ti.template(), now: ti.template(), i, crossing):
    """The lines that masses hit: those they remember, except in a step across a corner of the ground."""
    below, found = ti.static(work.segments_below, work.segments_hit)
    slope, intercept, nx, ny = below.slope[i], below.intercept[i], below.nx[i], below.ny[i]
    if crossing:
        for j in range(robot.simd.width):
            k = robot.simd.width * i + j
            at = now.x.each[k]
            if at >= below.start.each[k] and at < below.end.each[k]:
                for column, remembered in ti.static(zip(found, below, strict=True)):
                    column.each[j] = remembered.each[k]
            else:
                s = first_segment_hit(robot, at, now.y.each[k], now.wx.each[k], now.wy.each[k])
                store_segment(robot.ground, s, found, j)
        slope, intercept, nx, ny = found.slope[0], found.intercept[0], found.nx[0], found.ny[0]
    return slope, intercept, nx, ny


@ti.func
def sliding_speed(robot: ti.template(), below: ti.template(), i, wx, wy):
    """Speed along the ground after Coulomb's impulse: friction times the normal speed less, but not below 0.

    Returns it, signed, and the tangential and normal speeds before. The tangent is the normal turned right.
    """
    nx, ny = below.nx[i], below.ny[i]
    tangential, normal = wx * ny - wy * nx, wx * nx + wy * ny
    left = ti.max(absolute(tangential) - robot.friction * absolute(normal), robot.simd.lanes(0.0))
    return apply_sign(left, tangential), tangential, normal


@ti.func
def penetrates(robot: ti.template(), work: ti.template(), i, px, py):
    """1 for masses that free flight to p would put below the ground. Searches the ground where unclear."""
    zero, one = robot.simd.lanes(0.0), robot.simd.lanes(1.0)
    below = ti.static(work.segments_below)
    low = ti.select(py < robot.ground.max_height, is_outside(robot, below, i, px), zero)
    hit = ti.select(py < ground_height(below, i, px), one, low)
    if robot.simd.any_positive(hit):
        update_segments(robot, work, i, px)
        hit = ti.select(py < ground_height(below, i, px), one, zero)
    return hit


@ti.func
def friction_contact(robot: ti.template(), work: ti.template(), now: ti.template(), after: ti.template(), i):
    """With friction: corrects the positions and velocities of the i-th 16 masses after free flight of dt."""
    below = ti.static(work.segments_below)
    px, py = after.x[i], after.y[i]
    hit = penetrates(robot, work, i, px, py)
    contact = robot.simd.any_positive(hit)
    now.contact.each[i] = ti.cast(contact, robot.simd.real)
    if contact:
        x, y, wx, wy = now.x[i], now.y[i], now.wx[i], now.wy[i]
        crossing = robot.simd.any_positive(
            ti.select(hit > 0.5, is_outside(robot, below, i, x), robot.simd.lanes(0.0))
        )
        slope, intercept, nx, ny = lines_hit(robot, work, now, i, crossing)
        toi = ti.min(approach(robot, slope, intercept, nx, ny, x, y, wx, wy)[2], robot.dt)
        px = ti.select(hit > 0.5, x + toi * wx, px)
        if crossing:
            update_segments(robot, work, i, px)
        speed = sliding_speed(robot, below, i, wx, wy)[0]
        vx, vy = speed * below.ny[i], speed * (0.0 - below.nx[i])
        px = ti.select(hit > 0.5, px + (robot.dt - toi) * vx, px)
        update_segments(robot, work, i, px)
        lifted = ti.max(y + toi * wy + (robot.dt - toi) * vy, ground_height(below, i, px))
        after.x[i], after.y[i] = px, ti.select(hit > 0.5, lifted, py)
        after.vx[i], after.vy[i] = ti.select(hit > 0.5, vx, wx), ti.select(hit > 0.5, vy, wy)


@ti.func
def friction_contact_adjoint(robot: ti.template(), work: ti.template(), now: ti.template(), i):
    """Gradients with respect to x, w and friction, from those of position and velocity after the step."""
    g, below = ti.static(work.g, work.segments_below)
    if now.contact.each[i] > 0:
        zero, one = robot.simd.lanes(0.0), robot.simd.lanes(1.0)
        x, y, wx, wy = now.x[i], now.y[i], now.wx[i], now.wy[i]
        px, py = x + robot.dt * wx, y + robot.dt * wy
        update_segments(robot, work, i, px)
        hit = ti.select(py < ground_height(below, i, px), one, zero)
        crossing = robot.simd.any_positive(ti.select(hit > 0.5, is_outside(robot, below, i, x), zero))
        slope, intercept, line_nx, line_ny = lines_hit(robot, work, now, i, crossing)
        gap, closing, toi_on_line = approach(robot, slope, intercept, line_nx, line_ny, x, y, wx, wy)
        toi = ti.min(toi_on_line, robot.dt)
        rest = robot.dt - toi
        px = ti.select(hit > 0.5, x + toi * wx, px)
        if crossing:
            update_segments(robot, work, i, px)
        nx, ny = below.nx[i], below.ny[i]
        speed, tangential, normal = sliding_speed(robot, below, i, wx, wy)
        vx, vy = speed * ny, speed * (0.0 - nx)
        px = ti.select(hit > 0.5, px + rest * vx, px)
        py = y + toi * wy + rest * vy
        update_segments(robot, work, i, px)
        lifted = py < ground_height(below, i, px)
        gx, gy, gvx, gvy = g.x[i], g.y[i], g.vx[i], g.vy[i]
        gpx = ti.select(lifted, gx + below.slope[i] * gy, gx)
        gpy = ti.select(lifted, zero, gy)
        gwx, gwy = toi * gpx, toi * gpy
        # speed = |tangential| - friction |normal|, where that is not negative
        d_speed = apply_sign((gvx + rest * gpx) * ny - (gvy + rest * gpy) * nx, tangential)
        d_speed = ti.select(absolute(speed) > 0.0, d_speed, zero)
        if ti.static(robot.physics_gradients):
            d_friction = ti.static(robot.d_physics.friction)
            d_friction[0] = d_friction[0] - ti.select(hit > 0.5, d_speed * absolute(normal), zero)
        gwx += d_speed * (apply_sign(ny, tangential) - robot.friction * apply_sign(nx, normal))
        gwy += d_speed * (apply_sign(0.0 - nx, tangential) - robot.friction * apply_sign(ny, normal))
        # toi = |gap| / |closing|, where that is not beyond the step
        d_gap = (gpx * (wx - vx) + gpy * (wy - vy)) / (absolute(closing) + robot.epsilon)
        d_gap = ti.select(toi_on_line < robot.dt, d_gap, zero)
        d_x, d_w = apply_sign(d_gap, gap), apply_sign(d_gap, closing) * toi
        g.x[i] = ti.select(hit > 0.5, gpx + d_x * line_nx, gx)
        g.y[i] = ti.select(hit > 0.5, gpy + d_x * line_ny, gy)
        g.wx[i] = ti.select(hit > 0.5, gwx - d_w * line_nx, g.wx[i])
        g.wy[i] = ti.select(hit > 0.5, gwy - d_w * line_ny, g.wy[i])
