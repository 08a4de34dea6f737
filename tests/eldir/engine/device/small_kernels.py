"""Kernels of known cost. The compilers read annotations, so they are not postponed here."""

import numpy as np

from eldir.engine.compiler import ti

KEPT = 48


@ti.kernel
def share(a: ti.types.ndarray(ti.f32, ndim=1)):
    """A block of 64 threads shares 256 numbers."""
    ti.loop_config(block_dim=64)
    for i in range(640):
        shared = ti.simt.block.SharedArray((256,), ti.f32)
        shared[i % 64] = a[i]
        ti.simt.block.sync()
        a[i] = shared[63 - i % 64]


@ti.kernel
def keep(a: ti.types.ndarray(ti.f32, ndim=1)):
    """A thread needs KEPT numbers at the same time."""
    ti.loop_config(block_dim=128)
    for i in range(1280):
        kept = ti.Vector([a[i + k] for k in ti.static(range(KEPT))])
        for _ in range(ti.i32(a[0])):
            for k in ti.static(range(KEPT)):
                kept[k] = kept[k] * kept[(k + 7) % KEPT] + kept[(k + 1) % KEPT]
        for k in ti.static(range(KEPT)):
            a[i + k] = kept[k]


@ti.kernel
def walk(
    a: ti.types.ndarray(ti.f32, ndim=1), b: ti.types.ndarray(ti.f32, ndim=1), steps: ti.i32, rows: ti.i32
):
    """Steps with two barriers, and a loop over rows of `a` in each."""
    ti.loop_config(block_dim=64)
    for i in range(640):
        shared = ti.simt.block.SharedArray((64,), ti.f32)
        x = b[i]
        for _ in range(steps):
            shared[i % 64] = x
            ti.simt.block.sync()
            x = 0.0
            for row in range(rows):
                x += a[64 * row + i % 64] * shared[row]
            ti.simt.block.sync()
        b[i] = x


def add_up(precision, rounds):
    """Sums by 4 blocks of 64 threads: each adds `rounds` numbers in every thread, then the threads' sums."""
    real = getattr(ti, precision)

    @ti.kernel
    def add(a: ti.types.ndarray(real, ndim=1), sums: ti.types.ndarray(real, ndim=1), rounds: ti.i32):
        ti.loop_config(block_dim=64)
        for i in range(4 * 64):
            shared = ti.simt.block.SharedArray((64,), real)
            thread, block = i % 64, i // 64
            s = ti.cast(0, real)
            for k in range(rounds):
                s += a[(block * rounds + k) * 64 + thread]
            shared[thread] = s
            ti.simt.block.sync()
            if thread == 0:
                s = ti.cast(0, real)
                for k in range(64):
                    s += shared[k]
                sums[block] = s

    kind = np.float64 if precision == "f64" else np.float32
    numbers, sums = ti.ndarray(real, (4 * 64 * rounds,)), ti.ndarray(real, (4,))
    numbers.from_numpy(np.arange(4 * 64 * rounds, dtype=kind))
    sums.from_numpy(np.full(4, np.nan, kind))  # what is not written is seen
    add(numbers, sums, rounds)
    return sums.to_numpy().tolist()


def launch():
    """All, one of them twice."""
    array = ti.ndarray(ti.f32, (2048,))
    for kernel in (share, keep, keep):
        kernel(array)
    walk(array, array, 1, 1)
