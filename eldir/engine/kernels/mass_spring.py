"""The mass-spring system (paper, Sect. Simulation): Hooke's law with a rest length that a motor changes, then
the motion of the masses, each with its adjoint.

Spring s of family f goes from cell s to the cell `family_offset` further on (`eldir.engine.grid`); where
there is none, its stiffness is 0.
"""

from eldir.engine.compiler import ti
from eldir.engine.grid import FAMILIES
from eldir.engine.kernels.contact import (
    FRICTION,
    NO_SLIP,
    friction_contact,
    friction_contact_adjoint,
    no_slip_impact,
)
from eldir.engine.kernels.simd import fill, gather, one


@ti.func
def family_offset(robot: ti.template(), family):
    """Number of cells from the near to the far end of a family's springs."""
    return ti.select(family == 0, 1, robot.n.reach + family - 1)


@ti.func
def end_difference(robot: ti.template(), column: ti.template(), cells, i):
    """Values at the far ends of 16 springs minus those at their near ends."""
    return robot.simd.shifted(column, i, cells) - column[i]


@ti.func
def net_impulse(robot: ti.template(), work: ti.template(), i):
    """Sum of the impulses on 16 masses: of springs that end there, minus of those that begin there."""
    fx, fy = robot.simd.lanes(0.0), robot.simd.lanes(0.0)
    for family in ti.static(range(FAMILIES)):  # unrolled: 15 % of a whole iteration
        f = ti.static(work.forces.family(family))
        back = 0 - family_offset(robot, family)
        fx += end_difference(robot, f.x, back, i)
        fy += end_difference(robot, f.y, back, i)
    return fx, fy


@ti.func
def clear_springs(robot: ti.template()):
    """Zeros: the activations of passive springs, and the impulses beyond the grid."""
    simd, work = ti.static(robot.simd, robot.work)
    fill(simd, work.activations, FAMILIES * robot.n.cell_rows, 0.0)
    guard = robot.n.guard_rows
    for family in range(FAMILIES):
        f = ti.static(work.forces.family(family))
        fill(simd, f.x + (-16 * guard), guard, 0.0)
        fill(simd, f.y + (-16 * guard), guard, 0.0)


@ti.func
def set_activations(robot: ti.template(), now: ti.template()):
    for m in range(robot.n.motors):
        robot.work.activations.each[robot.motor.each[m]] = now.action.each[m]


@ti.func
def spring_impulse(
    robot: ti.template(), now: ti.template(), work: ti.template(), f: ti.template(), family, cells, i
):
    """Impulses f = dt k (L / l - 1) d of one family's springs from the i-th masses to those `cells` further
    on: k stiffness, L rest length, l length, d from the near to the far end."""
    s = family * robot.n.cell_rows + i
    dx, dy = end_difference(robot, now.x, cells, i), end_difference(robot, now.y, cells, i)
    length = ti.sqrt(dx * dx + dy * dy) + robot.softening
    rest_length = robot.rest_length[s] * (1.0 + robot.actuation * work.activations[s])
    strength = robot.stiffness_dt[s] * (rest_length / length - 1.0)
    f.x[i] = strength * dx
    f.y[i] = strength * dy


@ti.func
def spring_impulses(robot: ti.template(), now: ti.template()):
    """Impulses of all springs."""
    work = ti.static(robot.work)
    set_activations(robot, now)
    for family in range(FAMILIES):
        f = ti.static(work.forces.family(family))
        cells = family_offset(robot, family)
        i, next_row = 0, one(robot.n.masses)
        while i < robot.n.cell_rows:
            spring_impulse(robot, now, work, f, family, cells, i)
            i += next_row


@ti.func
def spring_impulse_adjoint(
    robot: ti.template(), now: ti.template(), work: ti.template(), f: ti.template(), family, cells, i
):
    """Adjoint of `spring_impulse`: writes the gradients of the far ends' positions into f, and those of the
    activations."""
    g = ti.static(work.g)
    s = family * robot.n.cell_rows + i
    dx, dy = end_difference(robot, now.x, cells, i), end_difference(robot, now.y, cells, i)
    gfx, gfy = end_difference(robot, g.wx, cells, i), end_difference(robot, g.wy, cells, i)
    distance = ti.max(ti.sqrt(dx * dx + dy * dy), robot.epsilon)
    length = distance + robot.softening
    per_both = 1.0 / (distance * length)
    per_length = per_both * distance
    d_rest_length = (gfx * dx + gfy * dy) * robot.stiffness_dt[s] * per_length
    factor = 1.0 + robot.actuation * work.activations[s]
    rest_length = robot.rest_length[s] * factor
    strength = robot.stiffness_dt[s] * (rest_length * per_length - 1.0)
    if ti.static(robot.physics_gradients):
        physics = ti.static(robot.d_physics)
        d_stiffness = (gfx * dx + gfy * dy) * (rest_length * per_length - 1.0)
        physics.stiffness_dt[s] = physics.stiffness_dt[s] + d_stiffness
        physics.rest_length[s] = physics.rest_length[s] + d_rest_length * factor
    d_length = d_rest_length * rest_length * per_both
    f.x[i] = strength * gfx - d_length * dx
    f.y[i] = strength * gfy - d_length * dy
    work.g_activations[s] = d_rest_length * robot.rest_length[s] * robot.actuation


@ti.func
def spring_impulses_adjoint(robot: ti.template(), now: ti.template(), delta: ti.template()):
    """Propagates the gradient of w to those of x and, before tanh, of the activations (`delta`)."""
    work, g = ti.static(robot.work, robot.work.g)
    set_activations(robot, now)
    for family in range(FAMILIES):
        f = ti.static(work.forces.family(family))
        cells = family_offset(robot, family)
        i, next_row = 0, one(robot.n.masses)
        while i < robot.n.cell_rows:
            spring_impulse_adjoint(robot, now, work, f, family, cells, i)
            i += next_row
    for b in range(2 * robot.n.motor_blocks):
        action = now.action[b]
        delta[b] = gather(robot.simd, work.g_activations, robot.motor, b) * (1.0 - action * action)
    k, next_row = 0, one(robot.n.masses)
    while k < robot.n.cell_rows:
        fx, fy = net_impulse(robot, work, k)
        g.x[k] = g.x[k] + fx
        g.y[k] = g.y[k] + fy
        k += next_row


@ti.func
def advance(robot: ti.template(), now: ti.template(), after: ti.template(), work: ti.template(), i):
    """Semi-implicit Euler: the i-th masses after a step of damping, gravity and impulses, in free flight or,
    without slip, where they land; returns their squared speeds before they land."""
    fx, fy = net_impulse(robot, work, i)
    wx = robot.decay * now.vx[i] + fx
    wy = robot.decay * now.vy[i] + fy + robot.gravity_dt * robot.mask[i]
    now.wx[i] = wx
    now.wy[i] = wy
    hit, toi = robot.simd.lanes(0.0), robot.simd.lanes(robot.dt)
    if ti.static(robot.ground.contact == NO_SLIP):
        hit, toi = no_slip_impact(robot, now.y[i], wy, robot.ground.level)
    after.x[i] = now.x[i] + toi * wx
    after.y[i] = now.y[i] + toi * wy
    after.vx[i] = wx * (1.0 - hit)
    after.vy[i] = wy * (1.0 - hit)
    return wx * wx + wy * wy


@ti.func
def advance_masses(robot: ti.template(), now: ti.template(), after: ti.template()):
    """Computes the state after a step from the one before; returns 1 where a mass of 16 was too fast."""
    too_fast = robot.simd.lanes(0.0)
    k, next_row = 0, one(robot.n.masses)
    while k < robot.n.cell_rows:  # not by the greatest speed: the maximum of NaN and a number is the number
        speed = advance(robot, now, after, robot.work, k)
        too_fast = ti.select(speed < robot.max_squared_speed, too_fast, robot.simd.lanes(1.0))
        k += next_row
    if ti.static(robot.ground.contact == FRICTION):  # a loop of its own: the one above stays free of branches
        for i in range(robot.n.cell_rows):
            friction_contact(robot, robot.work, now, after, i)
    return too_fast


@ti.func
def advance_adjoint(robot: ti.template(), now: ti.template(), g: ti.template(), i):
    """The gradients of the i-th masses' x and w, in free flight or without slip."""
    wx, wy = now.wx[i], now.wy[i]
    gx, gy = g.x[i], g.y[i]
    hit, toi = robot.simd.lanes(0.0), robot.simd.lanes(robot.dt)
    if ti.static(robot.ground.contact == NO_SLIP):
        hit, toi = no_slip_impact(robot, now.y[i], wy, robot.ground.level)
    gwx = toi * gx + (1.0 - hit) * g.vx[i]
    gwy = toi * gy + (1.0 - hit) * g.vy[i]
    if ti.static(robot.ground.contact == NO_SLIP):
        # toi = (level - y) / wy where the mass lands, else constant.
        d_toi = (gx * wx + gy * wy) * hit / ti.min(wy, -robot.min_landing_speed)
        g.y[i] = gy - d_toi
        gwy = gwy - d_toi * toi
    g.wx[i] = gwx
    g.wy[i] = gwy


@ti.func
def advance_masses_adjoint(robot: ti.template(), now: ti.template()):
    """Propagates the gradients of the state after a step to those of x, w and v before it."""
    g = ti.static(robot.work.g)
    k, next_row = 0, one(robot.n.masses)
    while k < robot.n.cell_rows:
        advance_adjoint(robot, now, g, k)
        k += next_row
    if ti.static(robot.ground.contact == FRICTION):
        for i in range(robot.n.cell_rows):
            friction_contact_adjoint(robot, robot.work, now, i)
    for i in range(robot.n.cell_rows):
        if ti.static(robot.physics_gradients):
            physics = ti.static(robot.d_physics)
            physics.decay[0] = physics.decay[0] + g.wx[i] * now.vx[i] + g.wy[i] * now.vy[i]
            physics.gravity_dt[0] = physics.gravity_dt[0] + g.wy[i] * robot.mask[i]
        g.vx[i] = robot.decay * g.wx[i]
        g.vy[i] = robot.decay * g.wy[i]
