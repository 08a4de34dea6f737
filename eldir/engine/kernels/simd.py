"""The vector types of one precision, moving values between vectors, tanh, and a test of the compiler's
vectors."""

import math
import platform
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eldir.engine.compiler import aligned, ti
from eldir.engine.kernels.memory import Column, Memory

CPU_FLAGS = Path("/proc/cpuinfo")
_FACTORIALS = [math.factorial(n) for n in range(13, 0, -1)]


class Simd(NamedTuple):
    """Types and functions that element functions compute with, known while compiling.

    On the CPU `lanes` holds `width` = 16 values. On a device it is a single value, and the same formulas hold
    (`eldir.engine.device.kernels.scalars`)."""

    real: Any
    """f32 or f64."""
    width: int
    lanes: Any
    """Type of a vector of `width` values."""
    row: Any
    """Type of a vector of 32 values, one of each hidden unit."""
    shifted: Any
    """`shifted(column, i, count)`: the i-th `width` values from value `count` on."""
    any_positive: Any
    """Whether any of `width` values, none negative, is not 0."""
    tanh: Any
    wide: bool = False
    """Whether the processor has registers for several sums of rows at a time."""


@cache
def vectors(precision: str) -> Simd:
    """The types for 'f32' or 'f64' on the CPU."""
    real = ti.f32 if precision == "f32" else ti.f64
    quad, eight, lanes, row = (ti.types.vector(n, real) for n in (4, 8, 16, 32))

    @ti.func
    def shifted(column: ti.template(), i, count):
        return lanes(column.unaligned[16 * i + count])

    @ti.func
    def any_positive(marks):
        """Halves are added, because one by one is slower."""
        a = eight([marks[j] for j in ti.static(range(8))]) + eight(
            [marks[8 + j] for j in ti.static(range(8))]
        )
        b = quad([a[j] for j in ti.static(range(4))]) + quad([a[4 + j] for j in ti.static(range(4))])
        return (b[0] + b[1]) + (b[2] + b[3]) > 0

    return Simd(real, 16, lanes, row, shifted, any_positive, tanh_of(real), has_wide_registers())


@ti.func
def one(count):
    """1, which LLVM does not know; `count` is any count. As the step of a loop it keeps LLVM from unrolling
    the loop.

    LLVM 15, in Taichi, believes that AMD's processors since Zen 3 keep loops of 512 operations in a buffer,
    and unrolls the hot loops up to sixteen times. In float64 with AVX2 that costs 12 to 20 %
    (docs/benchmarks.md)."""
    return 1 + (count >> 31)


@ti.func
def quad_component(simd: ti.template(), column: ti.template(), i, k: ti.template()):
    """Value k of each of the i-th 16 quads."""
    a, b, c, d = column[4 * i], column[4 * i + 1], column[4 * i + 2], column[4 * i + 3]
    return simd.lanes([v[4 * j + k] for v in ti.static((a, b, c, d)) for j in ti.static(range(4))])


@ti.func
def gather(simd: ti.template(), column: ti.template(), index: ti.template(), i):
    """The values of `column` at the i-th 16 indices."""
    first = 16 * i
    return simd.lanes([column.each[index.each[first + j]] for j in ti.static(range(16))])


@ti.func
def max_of(simd: ti.template(), scratch: ti.template(), values):
    """The greatest of `width` values, none negative; `scratch` has room for them."""
    scratch[0] = values
    most = ti.cast(0, simd.real)
    for j in range(simd.width):
        most = ti.max(most, scratch.each[j])
    return most


@ti.func
def fill(simd: ti.template(), column: ti.template(), count, value):
    for i in range(count):
        column[i] = simd.lanes(value)


def tanh_of(real: Any) -> Any:
    """tanh for numbers of type `real`: to 1e-7 in float32, to 1e-15 in float64."""
    return tanh_f32 if real == ti.f32 else tanh_f64


@ti.func
def tanh_f32(x):
    """A rational approximation, without branches."""
    z = ti.min(ti.max(x, -7.9053111), 7.9053111)
    q = z * z
    p = q * -2.76076847742355e-16 + 2.00018790482477e-13
    p = p * q - 8.60467152213735e-11
    p = p * q + 5.12229709037114e-08
    p = p * q + 1.48572235717979e-05
    p = p * q + 6.37261928875436e-04
    p = p * q + 4.89352455891786e-03
    d = q * 1.19825839466702e-06 + 1.18534705686654e-04
    d = d * q + 2.26843463243900e-03
    d = d * q + 4.89352518554385e-03
    return z * p / d


@ti.func
def tanh_f64(x):
    """The series of exp(z) - 1 near 0, then doubled seven times, z to 2 z; without branches."""
    z = ti.min(ti.max(x, -20.0), 20.0) / 64.0
    u = 0.0 * z
    for denominator in ti.static(_FACTORIALS):
        u = (u + ti.f64(1 / denominator)) * z
    for _ in ti.static(range(7)):
        u = u * (u + 2.0)
    return u / (u + 2.0)


@cache
def has_wide_registers() -> bool:
    """Whether the processor has 32 registers of 512 bits (AVX-512).

    Sums over the 32 hidden units are then computed four or eight at a time, so that each value is loaded
    once for all of them. AVX2 has 16 registers of 256 bits, of which one such sum takes four in float32 and
    eight in float64. Of several sums, some would be stored and loaded again at every step.
    """
    if platform.machine() != "x86_64":  # an emulated processor may show the flags of its host
        return False
    try:
        return "avx512f" in CPU_FLAGS.read_text().split()
    except OSError:
        return False


def vectors_work() -> bool:
    """Whether the compiler's vector registers work on this machine: every vector operation that the kernels
    use, compared with NumPy. Taichi does not document the option that `eldir.engine.runtime` sets."""
    simd = vectors("f32")
    scalars, ints = ti.types.ndarray(dtype=ti.f32, ndim=1), ti.types.ndarray(dtype=ti.i32, ndim=1)
    by_1, by_2, by_4, by_16, by_32 = (
        ti.types.ndarray(dtype=ti.types.vector(n, ti.f32), ndim=1) for n in (1, 2, 4, 16, 32)
    )

    @ti.kernel
    def compute(
        values: scalars, x1: by_1, x2: by_2, x4: by_4, x16: by_16, x32: by_32, index_: ints, ahead: ti.i32,
        out: by_16,
    ):  # fmt: skip
        for _ in range(1):
            x = ti.static(Column(Memory(values, x1, x2, x4, x16, x32), 0))
            index = ti.static(Column(Memory(values=index_), 0))
            x.pair[1] = x.pair[1] + x.pair[2]
            x.quad[2] = x.quad[3]
            out[0] = gather(simd, x, index, 0)
            out[1] = ti.select(x[1] < 0.5, simd.shifted(x, 0, ahead), simd.shifted(x, 3, 0 - ahead))
            out[2] = ti.sqrt(ti.max(x[2], x[3])) / (x[0] + 1.0)
            row = simd.row(0.0)
            for i in range(2):
                row += x.row[i] * x.each[i]
            out[3] = simd.lanes(row.sum())
            out[4] = quad_component(simd, x, 0, 2)

    rng = np.random.default_rng(0)
    x, out, index = aligned(64, np.float32), aligned(80, np.float32), aligned(16, np.int32)
    x[:], index[:] = rng.random(64), rng.permutation(64)[:16]
    expected = _expected_vectors(x.copy(), index)
    try:
        compute(x, *(x.reshape(-1, n) for n in (1, 2, 4, 16, 32)), index, 5, out.reshape(-1, 16))
    except Exception:  # whatever Taichi makes of an option that it does not know
        return False
    return bool(np.allclose(out.reshape(5, 16), expected, rtol=1e-5))


def _expected_vectors(x, index):
    """What `compute` above writes, by NumPy."""
    x[2:4] += x[4:6]
    x[8:12] = x[12:16]
    a, b, c, d = x.reshape(4, 16)
    selected = np.where(b < 0.5, x[5:21], x[43:59])
    roots = np.sqrt(np.maximum(c, d)) / (a + 1)
    total = x.reshape(2, 32).sum(axis=1) @ x[:2]
    return [x[index], selected, roots, np.full(16, total), x[2::4]]
