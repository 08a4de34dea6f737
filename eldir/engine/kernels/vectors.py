"""The vector types of one precision, and moving values between them."""

from functools import cache
from types import SimpleNamespace

from eldir.engine.compiler import ti


@cache
def vectors(precision: str) -> SimpleNamespace:
    """Types and functions for 'f32' or 'f64'."""
    real = ti.f32 if precision == "f32" else ti.f64
    pair, quad, eight, lanes, row = (ti.types.vector(n, real) for n in (2, 4, 8, 16, 32))

    @ti.func
    def shifted(column: ti.template(), i, count):
        """The i-th 16 values from value `count` on, at any address."""
        return lanes(column.unaligned[16 * i + count])

    @ti.func
    def fourth(column: ti.template(), i, k: ti.template()):
        """Value k of each of the i-th 16 quads."""
        a, b, c, d = column[4 * i], column[4 * i + 1], column[4 * i + 2], column[4 * i + 3]
        return lanes([v[4 * j + k] for v in ti.static((a, b, c, d)) for j in ti.static(range(4))])

    @ti.func
    def gather(column: ti.template(), index: ti.template(), i):
        """The values of `column` at the i-th 16 indices."""
        first = 16 * i
        return lanes([column.each[index.each[first + j]] for j in ti.static(range(16))])

    @ti.func
    def any(marks):
        """Whether any of 16 values, none negative, is not 0. Halves are added, because one by one is
        slower."""
        a = eight([marks[j] for j in ti.static(range(8))]) + eight(
            [marks[8 + j] for j in ti.static(range(8))]
        )
        b = quad([a[j] for j in ti.static(range(4))]) + quad([a[4 + j] for j in ti.static(range(4))])
        return (b[0] + b[1]) + (b[2] + b[3]) > 0

    @ti.func
    def fill(column: ti.template(), count, value):
        for i in range(count):
            column[i] = lanes(value)

    return SimpleNamespace(
        real=real,
        width=16,
        pair=pair,
        quad=quad,
        lanes=lanes,
        row=row,
        fourth=fourth,
        shifted=shifted,
        gather=gather,
        any=any,
        fill=fill,
    )
