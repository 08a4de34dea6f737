"""Force laws of the printed robot's strips (docs/reference/built.md).

Numbers are vectors that hold one value for each of several robots, or dual numbers of such vectors.
"""

from eldir.engine.built.dual import Dual, callable_in_kernels, maximum, minimum
from eldir.engine.built.motion_launch import ONE, ZERO, LaneVector
from eldir.engine.compiler import ti


@ti.func
def strip_tension(length, free, stiffness, buckling):
    """Tension of a strip [N]. In compression it carries its buckling load, and a little more as it bends."""
    stretch = length - free
    buckled = buckling * minimum(0.5 * stretch / free - ONE, ZERO)  # -PE (1 + s / 2 L)
    return maximum(stiffness * stretch, buckled)


@callable_in_kernels
def unit_vector_angle(sine, cosine):
    """Angle of a unit vector, in (-pi, pi)."""
    if not isinstance(sine, Dual):
        return angle_by_series(sine, cosine)
    turn = cosine.value * sine.derivative - sine.value * cosine.derivative
    return Dual(angle_by_series(sine.value, cosine.value), turn)


@ti.func
def angle_by_series(sine, cosine):
    """Four times the arc tangent of the quarter angle's tangent, accurate to 1e-12 up to a right angle."""
    half = sine / (LaneVector(1.0 + 1e-15) + cosine)
    t = half / (ONE + ti.sqrt(ONE + half * half))
    q = t * t
    series = LaneVector(1.0 / 27)
    for n in ti.static(range(25, 0, -2)):
        series = LaneVector(1.0 / n) - q * series
    return 4.0 * t * series


@ti.func
def end_rotation(nx, ny, cosine, sine, ex, ey):
    """Angle of a strip's end from its chord (nx, ny). (ex, ey) is the chord at rest, and the hexagon in which
    the strip is clamped is turned by (cosine, sine)."""
    tx, ty = cosine * ex - sine * ey, sine * ex + cosine * ey
    return unit_vector_angle(nx * ty - ny * tx, nx * tx + ny * ty)


@ti.func
def bending_angle(rotation, excess, play):
    """Angle by which a strip's end is bent from its chord. Its hexagon has turned by `rotation`; the other
    hexagon has turned by `excess` more than the play. The end turns in its socket to where it bears no
    moment, which is half of the other end's angle, to the other side."""
    return maximum(minimum(-0.5 * excess, rotation + play), rotation - play)


@ti.func
def end_moments(bending, pa, pb):
    """Moments at the ends of a beam whose ends are turned by pa and pb from its chord (slope-deflection
    method): k (4 pa + 2 pb) and k (2 pa + 4 pb)."""
    both = pa + pb
    return 2.0 * bending * (pa + both), 2.0 * bending * (pb + both)


@ti.func
def interpolate(table: ti.template(), q, active, part):
    """A shape-memory spring's value, linear between the given instants."""
    return table[q] + part * (table[q + active] - table[q])
