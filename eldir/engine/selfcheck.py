"""A test whether matrices in vector registers work on this machine. Taichi does not document that option."""

import numpy as np

from eldir.engine.aligned import aligned
from eldir.engine.compiler import ti
from eldir.engine.kernels.memory import Column, Memory
from eldir.engine.kernels.vectors import vectors


def vectors_work() -> bool:
    """Compares every vector operation that the kernels use with NumPy."""
    kind = vectors("f32")
    scalars, ints = ti.types.ndarray(dtype=ti.f32, ndim=1), ti.types.ndarray(dtype=ti.i32, ndim=1)
    by_1, by_2, by_4, by_16, by_32 = (
        ti.types.ndarray(dtype=v, ndim=1)
        for v in (ti.types.vector(1, ti.f32), kind.pair, kind.quad, kind.lanes, kind.row)
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
            out[0] = kind.gather(x, index, 0)
            out[1] = ti.select(x[1] < 0.5, kind.shifted(x, 0, ahead), kind.shifted(x, 3, 0 - ahead))
            out[2] = ti.sqrt(ti.max(x[2], x[3])) / (x[0] + 1.0)
            row = kind.row(0.0)
            for i in range(2):
                row += x.row[i] * x.each[i]
            out[3] = kind.lanes(row.sum())
            out[4] = kind.fourth(x, 0, 2)

    rng = np.random.default_rng(0)
    x, out, index = aligned(64, np.float32), aligned(80, np.float32), aligned(16, np.int32)
    x[:], index[:] = rng.random(64), rng.permutation(64)[:16]
    expected = x.copy()
    try:
        compute(x, *(x.reshape(-1, n) for n in (1, 2, 4, 16, 32)), index, 5, out.reshape(-1, 16))
    except Exception:  # whatever Taichi makes of an option that it does not know
        return False
    expected[2:4] += expected[4:6]
    expected[8:12] = expected[12:16]
    a, b, c, d = expected.reshape(4, 16)
    picked = np.where(b < 0.5, expected[5:21], expected[43:59])
    rooted = np.sqrt(np.maximum(c, d)) / (a + 1)
    total = expected.reshape(2, 32).sum(axis=1) @ expected[:2]
    wanted = [expected[index], picked, rooted, np.full(16, total), expected[2::4]]
    return bool(np.allclose(out.reshape(5, 16), wanted, rtol=1e-5))
