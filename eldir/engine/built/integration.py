"""Motion of the masses and hexagons of a group of printed robots in one step.

The table is y = 0, with dry friction (Coulomb) that is not regularised. `now` are the group's values
(`GroupArrays`), which are dual numbers where tangents are computed.
"""

from eldir.engine.built.dual import maximum, minimum, negative, select
from eldir.engine.built.motion_launch import ONE, ZERO
from eldir.engine.compiler import ti


@ti.func
def coulomb_contact(height, tangential, normal, forward, backward, dt):
    """Speeds of a mass along the table and upwards after the table's impulse: it ends the fall within the
    step, and slows the mass by at most its coefficient times that, `forward` or `backward` as it slides."""
    normal_impulse = maximum(negative(height / dt) - normal, ZERO)
    limited = minimum(tangential, forward * normal_impulse)
    friction_impulse = maximum(limited, negative(backward * normal_impulse))
    return tangential - friction_impulse, normal + normal_impulse


@ti.func
def move_masses(group: ti.template(), now: ti.template(), going):
    """Semi-implicit Euler with drag, gravity, impulses and the table. Robots not `going` wait."""
    for i in range(group.masses):
        w, before_x, before_y = now.inverse_mass[i], now.vx[i], now.vy[i]
        wx = now.numbers.decay * before_x + now.impulse_x[i] * w + now.numbers.gravity_tangent_dt
        wy = now.numbers.decay * before_y + now.impulse_y[i] * w + now.numbers.gravity_normal_dt
        forward = now.friction[i]
        backward = forward * now.parameters.backward_friction
        vx, vy = coulomb_contact(now.y[i], wx, wy, forward, backward, group.dt)
        now.x[i] = now.x[i] + select(going, group.dt * vx, ZERO)
        now.y[i] = now.y[i] + select(going, group.dt * vy, ZERO)
        now.vx[i] = select(going, vx, before_x)
        now.vy[i] = select(going, vy, before_y)
        now.impulse_x[i] = ZERO
        now.impulse_y[i] = ZERO


@ti.func
def turn_hexagons(group: ti.template(), now: ti.template(), going):
    for i in range(group.masses):
        before = now.spin[i]
        after = now.numbers.decay * before + now.moment[i] * now.inverse_inertia[i]
        turn_hexagon(group, now, i, select(going, after, before), going)
        now.moment[i] = ZERO


@ti.func
def turn_hexagon(group: ti.template(), now: ti.template(), i, spin, going):
    """Cayley's rotation by dt spin, which keeps cosine^2 + sine^2 = 1."""
    half = select(going, 0.5 * group.dt * spin, ZERO)
    square, double = half * half, half + half
    scale, c0, s0 = 1.0 / (square + ONE), now.cosine[i], now.sine[i]
    now.cosine[i] = ((1.0 - square) * c0 - double * s0) * scale
    now.sine[i] = ((1.0 - square) * s0 + double * c0) * scale
    now.spin[i] = spin
