"""Printed strips and shape-memory springs of the built robot (docs/reference/built.md).

Vectors hold one value for each of several robots.
"""

from types import SimpleNamespace
from typing import Any

from eldir.engine.compiler import ti


def functions(lane: Any) -> SimpleNamespace:
    """The elements for one type of vector."""
    zero, one = lane(0.0), lane(1.0)

    @ti.func
    def tension(length, free, stiffness, buckling):
        """Tension of a strip [N]. In compression it carries its buckling load, and a little more as it
        bends."""
        stretch = length - free
        bent = buckling * ti.min(0.5 * stretch / free - one, zero)  # -PE (1 + s / 2 L)
        return ti.max(stiffness * stretch, bent)

    @ti.func
    def tension_slope(length, free, stiffness, buckling, length_, free_, stiffness_, buckling_):
        """Change of the tension as its arguments change; names with _ are slopes."""
        stretch, stretch_ = length - free, length_ - free_
        bend = 0.5 * stretch / free - one
        bent, hooke = buckling * ti.min(bend, zero), stiffness * stretch
        bent_ = ti.select(
            bend < zero, buckling_ * bend + 0.5 * buckling * (stretch_ - stretch * free_ / free) / free, zero
        )
        return ti.select(hooke < bent, bent_, stiffness_ * stretch + stiffness * stretch_)

    @ti.func
    def angle(sine, cosine):
        """Angle of a unit vector, in (-pi, pi): four times the arc tangent of the quarter angle's tangent, by
        its series, accurate to 1e-12 up to a right angle."""
        half = sine / (lane(1.0 + 1e-15) + cosine)
        t = half / (one + ti.sqrt(one + half * half))
        q = t * t
        series = lane(1.0 / 27)
        for n in ti.static(range(25, 0, -2)):
            series = lane(1.0 / n) - q * series
        return 4.0 * t * series

    @ti.func
    def rotation(nx, ny, cosine, sine, ex, ey):
        """Angle of a strip's end from its chord (nx, ny). (ex, ey) is the chord at rest, and the hexagon in
        which the strip is clamped is turned by (cosine, sine)."""
        tx, ty = cosine * ex - sine * ey, sine * ex + cosine * ey
        return angle(nx * ty - ny * tx, nx * tx + ny * ty)

    @ti.func
    def rotation_slope(nx, ny, cosine, sine, nx_, ny_, cosine_, sine_):
        """Slope of `rotation`: the cross products of unit vectors with their slopes."""
        return (cosine * sine_ - sine * cosine_) - (nx * ny_ - ny * nx_)

    @ti.func
    def bent(turned, beyond, play):
        """Angle by which a strip's end is bent from its chord. Its hexagon has turned by `turned`; the other
        hexagon has turned by `beyond` more than the play. The end turns in its socket towards where it bears
        no moment, which is half of the other end's angle, to the other side."""
        return ti.max(ti.min(-0.5 * beyond, turned + play), turned - play)

    @ti.func
    def moments(bending, pa, pb):
        """Moments at the ends of a beam whose ends are turned by pa and pb from its chord (slope-deflection):
        k (4 pa + 2 pb) and k (2 pa + 4 pb)."""
        both = pa + pb
        return 2.0 * bending * (pa + both), 2.0 * bending * (pb + both)

    return SimpleNamespace(
        tension=tension, tension_slope=tension_slope, rotation=rotation, rotation_slope=rotation_slope,
        moments=moments, bent=bent,
    )  # fmt: skip
