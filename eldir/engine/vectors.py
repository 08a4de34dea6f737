"""The vector types of one precision, and moving values between them."""

from functools import cache
from types import SimpleNamespace

import taichi as ti


@cache
def vectors(precision: str) -> SimpleNamespace:
    """Types and functions for 'f32' or 'f64'."""
    real = ti.f32 if precision == "f32" else ti.f64
    pair, lanes, row = (ti.types.vector(n, real) for n in (2, 16, 32))

    @ti.func
    def evens(a, b):
        return lanes([a[0], a[2], a[4], a[6], a[8], a[10], a[12], a[14],
                      b[0], b[2], b[4], b[6], b[8], b[10], b[12], b[14]])  # fmt: skip

    @ti.func
    def odds(a, b):
        return lanes([a[1], a[3], a[5], a[7], a[9], a[11], a[13], a[15],
                      b[1], b[3], b[5], b[7], b[9], b[11], b[13], b[15]])  # fmt: skip

    @ti.func
    def gather(column: ti.template(), index: ti.template(), i):
        """The values of `column` at the i-th 16 indices."""
        first = 16 * i
        return lanes([column.each[index.each[first + j]] for j in ti.static(range(16))])

    @ti.func
    def fill(column: ti.template(), count, value):
        for i in range(count):
            column[i] = lanes(value)

    return SimpleNamespace(
        real=real, pair=pair, lanes=lanes, row=row, evens=evens, odds=odds, gather=gather, fill=fill
    )
