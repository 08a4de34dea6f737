"""Kernels of known cost. The compilers read annotations, so they are not postponed here."""

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


def launch():
    """All, one of them twice."""
    array = ti.ndarray(ti.f32, (2048,))
    for kernel in (share, keep, keep):
        kernel(array)
    walk(array, array, 1, 1)


def launch_none():
    """Nothing is launched."""
