"""Springs: Hooke's law with a rest length that a motor changes (paper, Sect. Simulation)."""

from types import SimpleNamespace

from eldir.engine.compiler import ti
from eldir.engine.grid import FAMILIES


def functions(kind: SimpleNamespace) -> SimpleNamespace:
    """Forward and adjoint for one precision. Spring s of family f goes from cell s on to a cell further on
    (`grid.py`); where there is none, its stiffness is 0."""
    lanes, shifted = kind.lanes, kind.shifted

    @ti.func
    def ahead(body: ti.template(), family):
        """Number of cells from the near to the far end of a family's springs."""
        return ti.select(family == 0, 1, body.n.reach + family - 1)

    @ti.func
    def across(column: ti.template(), cells, i):
        """Values at the far ends of 16 springs minus those at their near ends."""
        return shifted(column, i, cells) - column[i]

    @ti.func
    def total(work: ti.template(), body: ti.template(), i):
        """Sum of the forces on 16 masses: of springs that end there, minus of those that begin there."""
        fx, fy = lanes(0.0), lanes(0.0)
        for family in ti.static(range(FAMILIES)):  # unrolled: 15 % of a whole iteration
            f = ti.static(work.forces.of(family))
            back = 0 - ahead(body, family)
            fx += across(f.x, back, i)
            fy += across(f.y, back, i)
        return fx, fy

    @ti.func
    def prepare(body: ti.template(), work: ti.template()):
        """Zeros: the activations of passive springs, and the forces beyond the grid."""
        kind.fill(work.activations, FAMILIES * body.n.cell_rows, 0.0)
        guard = body.n.guard_rows
        for family in range(FAMILIES):
            f = ti.static(work.forces.of(family))
            kind.fill(f.x + (-16 * guard), guard, 0.0)
            kind.fill(f.y + (-16 * guard), guard, 0.0)

    @ti.func
    def set_activations(now: ti.template(), body: ti.template(), work: ti.template()):
        for m in range(body.n.motors):
            work.activations.each[body.motor.each[m]] = now.action.each[m]

    @ti.func
    def push_row(
        now: ti.template(), body: ti.template(), law: ti.template(), work: ti.template(),
        f: ti.template(), family, cells, i,
    ):  # fmt: skip
        """Impulses of one family's springs from the i-th masses to those `cells` further on."""
        s = family * body.n.cell_rows + i
        dx, dy = across(now.x, cells, i), across(now.y, cells, i)
        length = ti.sqrt(dx * dx + dy * dy) + law.softening
        target = body.rest_length[s] * (1.0 + law.actuation * work.activations[s])
        strength = body.stiffness_dt[s] * (target / length - 1.0)
        f.x[i] = strength * dx
        f.y[i] = strength * dy

    @ti.func
    def push(now: ti.template(), body: ti.template(), law: ti.template(), work: ti.template()):
        """Impulses f = dt k (target / l - 1) d."""
        set_activations(now, body, work)
        for family in range(FAMILIES):
            f = ti.static(work.forces.of(family))
            cells = ahead(body, family)
            for i in range(body.n.cell_rows):
                push_row(now, body, law, work, f, family, cells, i)

    @ti.func
    def push_adjoint_row(
        now: ti.template(), body: ti.template(), law: ti.template(), work: ti.template(),
        slopes: ti.template(), f: ti.template(), family, cells, i,
    ):  # fmt: skip
        """The same backward: writes what the far ends' gradients gain, and the activations' gradients."""
        g = ti.static(work.g)
        s = family * body.n.cell_rows + i
        dx, dy = across(now.x, cells, i), across(now.y, cells, i)
        gfx, gfy = across(g.wx, cells, i), across(g.wy, cells, i)
        distance = ti.max(ti.sqrt(dx * dx + dy * dy), law.tiny)
        length = distance + law.softening
        per_both = 1.0 / (distance * length)
        per_length = per_both * distance
        along = (gfx * dx + gfy * dy) * body.stiffness_dt[s] * per_length
        change = 1.0 + law.actuation * work.activations[s]
        target = body.rest_length[s] * change
        strength = body.stiffness_dt[s] * (target * per_length - 1.0)
        if ti.static(law.physical):
            pulled = (gfx * dx + gfy * dy) * (target * per_length - 1.0)
            slopes.stiffness_dt[s] = slopes.stiffness_dt[s] + pulled
            slopes.rest_length[s] = slopes.rest_length[s] + along * change
        lengthening = along * target * per_both
        f.x[i] = strength * gfx - lengthening * dx
        f.y[i] = strength * gfy - lengthening * dy
        work.g_activations[s] = along * body.rest_length[s] * law.actuation

    @ti.func
    def push_adjoint(
        now: ti.template(), body: ti.template(), law: ti.template(), work: ti.template(),
        slopes: ti.template(), delta: ti.template(),
    ):  # fmt: skip
        """Propagates the gradient of w to those of x and, before tanh, of the activations (`delta`)."""
        g = ti.static(work.g)
        set_activations(now, body, work)
        for family in range(FAMILIES):
            f = ti.static(work.forces.of(family))
            cells = ahead(body, family)
            for i in range(body.n.cell_rows):
                push_adjoint_row(now, body, law, work, slopes, f, family, cells, i)
        for b in range(2 * body.n.motor_blocks):
            action = now.action[b]
            delta[b] = kind.gather(work.g_activations, body.motor, b) * (1.0 - action * action)
        for i in range(body.n.cell_rows):
            fx, fy = total(work, body, i)
            g.x[i] = g.x[i] + fx
            g.y[i] = g.y[i] + fy

    return SimpleNamespace(
        ahead=ahead, prepare=prepare, push=push, push_row=push_row,
        push_adjoint=push_adjoint, push_adjoint_row=push_adjoint_row, total=total,
    )  # fmt: skip
