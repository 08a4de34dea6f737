"""Motion of the masses and hexagons of a group of printed robots in one step, each with its tangent.

The table is y = 0, with dry friction (Coulomb) that is not regularised. `now` are the values (`GroupArrays`)
and `tangent` their derivatives; names that begin with d_ are tangents (see `impulses`).
"""

from eldir.engine.built.motion_launch import ONE, ZERO
from eldir.engine.compiler import ti


@ti.func
def coulomb_contact(height, tangential, normal, friction, dt):
    """Speeds of a mass along the table and upwards after the table's impulse: it ends the fall within the
    step, and changes the tangential speed by at most `friction` times that."""
    normal_impulse = ti.max(ZERO - height / dt - normal, ZERO)
    max_friction = friction * normal_impulse
    friction_impulse = ti.max(ti.min(tangential, max_friction), ZERO - max_friction)
    return tangential - friction_impulse, normal + normal_impulse


@ti.func
def coulomb_contact_tangent(
    height, tangential, normal, friction, dt,
    d_height, d_tangential, d_normal, d_friction,
):  # fmt: skip
    """Change of the speeds after as those before change."""
    needed = ZERO - height / dt - normal
    impulse = ti.max(needed, ZERO)
    d_impulse = ti.select(needed > ZERO, ZERO - d_height / dt - d_normal, ZERO)
    max_friction, d_max_friction = friction * impulse, d_friction * impulse + friction * d_impulse
    slipping = ti.select(tangential < ZERO, d_tangential + d_max_friction, d_tangential - d_max_friction)
    in_contact = ti.select(ti.max(tangential, ZERO - tangential) > max_friction, slipping, ZERO)
    return ti.select(needed > ZERO, in_contact, d_tangential), d_normal + d_impulse


@ti.func
def move_masses(group: ti.template(), now: ti.template(), tangent: ti.template(), going):
    """Semi-implicit Euler with drag, gravity, impulses and the table. Robots not `going` wait."""
    for i in range(group.masses):
        w, before_x, before_y = now.inverse_mass[i], now.vx[i], now.vy[i]
        wx = now.decay * before_x + now.impulse_x[i] * w + now.gravity_tangent_dt
        wy = now.decay * before_y + now.impulse_y[i] * w + now.gravity_normal_dt
        vx, vy = coulomb_contact(now.y[i], wx, wy, now.friction[i], group.dt)
        if ti.static(group.tangents):
            move_mass_tangent(group, now, tangent, i, before_x, before_y, wx, wy, going)
        move_mass(group, now, i, before_x, before_y, vx, vy, going)


@ti.func
def move_mass_tangent(
    group: ti.template(), now: ti.template(), tangent: ti.template(), i, before_x, before_y, wx, wy, going
):
    """Moves the tangents of mass i, whose speeds are `before` and, before contact, w."""
    w, d_w = now.inverse_mass[i], tangent.inverse_mass[i]
    d_before_x, d_before_y = tangent.vx[i], tangent.vy[i]
    d_wx = tangent.decay * before_x + now.decay * d_before_x + tangent.gravity_tangent_dt
    d_wy = tangent.decay * before_y + now.decay * d_before_y + tangent.gravity_normal_dt
    d_wx = d_wx + tangent.impulse_x[i] * w + now.impulse_x[i] * d_w
    d_wy = d_wy + tangent.impulse_y[i] * w + now.impulse_y[i] * d_w
    d_vx, d_vy = coulomb_contact_tangent(
        now.y[i], wx, wy, now.friction[i], group.dt, tangent.y[i], d_wx, d_wy, tangent.friction[i]
    )
    move_mass(group, tangent, i, d_before_x, d_before_y, d_vx, d_vy, going)


@ti.func
def move_mass(group: ti.template(), now: ti.template(), i, before_x, before_y, vx, vy, going):
    """Moves mass i with its new speeds, or its tangents with theirs, and clears its impulse."""
    now.x[i] = now.x[i] + ti.select(going, group.dt * vx, ZERO)
    now.y[i] = now.y[i] + ti.select(going, group.dt * vy, ZERO)
    now.vx[i] = ti.select(going, vx, before_x)
    now.vy[i] = ti.select(going, vy, before_y)
    now.impulse_x[i] = ZERO
    now.impulse_y[i] = ZERO


@ti.func
def turn_hexagons(group: ti.template(), now: ti.template(), tangent: ti.template(), going):
    """Cayley's rotation by dt spin, which keeps cosine^2 + sine^2 = 1."""
    for i in range(group.masses):
        before, w = now.spin[i], now.inverse_inertia[i]
        after = now.decay * before + now.moment[i] * w
        after = ti.select(going, after, before)
        h = ti.select(going, 0.5 * group.dt * after, ZERO)
        scale, h2 = ONE / (ONE + h * h), h + h
        c0, s0 = now.cosine[i], now.sine[i]
        c1 = ((ONE - h * h) * c0 - h2 * s0) * scale
        s1 = ((ONE - h * h) * s0 + h2 * c0) * scale
        if ti.static(group.tangents):
            d_before, d_w = tangent.spin[i], tangent.inverse_inertia[i]
            d_after = tangent.decay * before + now.decay * d_before
            d_after = d_after + tangent.moment[i] * w + now.moment[i] * d_w
            d_after = ti.select(going, d_after, d_before)
            d_h = ti.select(going, 0.5 * group.dt * d_after, ZERO)
            d_angle = 2.0 * d_h * scale  # of the angle 2 atan(h)
            d_c0, d_s0 = tangent.cosine[i], tangent.sine[i]
            d_c1 = ((ONE - h * h) * d_c0 - h2 * d_s0) * scale - d_angle * s1
            d_s1 = ((ONE - h * h) * d_s0 + h2 * d_c0) * scale + d_angle * c1
            tangent.cosine[i], tangent.sine[i], tangent.spin[i] = d_c1, d_s1, d_after
            tangent.moment[i] = ZERO
        now.cosine[i], now.sine[i], now.spin[i] = c1, s1, after
        now.moment[i] = ZERO
