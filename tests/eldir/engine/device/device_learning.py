"""Learning on a device that the process started before: the engine's packing, kernels and launches."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from eldir.controller import Controller
from eldir.engine import batch as host
from eldir.engine.compiler import NAME, ti
from eldir.engine.device import update
from eldir.engine.device.records import DeviceTask
from eldir.engine.device.run import DeviceMemory, run
from eldir.engine.runtime import set_compile_options, start
from eldir.lattice import Lattice
from eldir.morphology import Morphology
from eldir.physics import Physics, resolve_physics
from eldir.scene import Scene
from tests.eldir.engine.random_robots import robots

LENGTH = 0.1
"""Of an update."""
PAPER = [13, 22]


def some_scene(precision: str, steps: int) -> Scene:
    return Scene(steps=steps, precision=precision, contact="no-slip", integrator="paper")


def ndarray_memory() -> DeviceMemory:
    """The memory of the device."""

    def array(a: NDArray) -> object:
        made = ti.ndarray(
            ti.i32 if a.dtype == np.int32 else getattr(ti, f"f{8 * a.itemsize}"), (max(len(a), 1),)
        )
        if len(a):
            made.from_numpy(np.ascontiguousarray(a))
        return made

    return DeviceMemory(array, lambda n, kind: array(np.zeros(n, kind)), lambda a: a.to_numpy(), 2**28)


@contextmanager
def on_processor() -> Iterator[None]:
    """The engine, started, and device kernels that compile in seconds in float64.

    Taichi's LLVM takes 80 s for the addresses of two steps at once in `update`, and 9 s for those of one."""
    start()
    set_compile_options("f64")
    with patch.object(update, "STEPS_AT_ONCE", 1 if NAME == "taichi" else update.STEPS_AT_ONCE):
        yield


def make_task(
    bodies: list[Morphology],
    brains: list[Controller],
    scene: Scene,
    iterations: int = 0,
    span: int | None = None,
    physics: list[Physics] | None = None,
) -> DeviceTask:
    """What a device computes of these robots. A launch computes at most `span` steps."""
    owns = resolve_physics(bodies, scene, physics)
    task = host.device_task(host.pack(bodies, brains, scene, owns), scene, iterations, LENGTH)
    return task._replace(settings=task.settings._replace(end=span or scene.steps))


def prepare(
    precision: str, steps: int, count: int, iterations: int, span: int, seed: int, size: list[int]
) -> DeviceTask:
    """`count` random robots of a lattice of `size`."""
    scene = some_scene(precision, steps)
    return make_task(*robots(Lattice(*size), count, seed, scene), scene, iterations, span)


def learn(*task: object) -> list[list[float]]:
    """The arguments are those of `prepare`. Losses, status, and best weights or gradients, flat."""
    outcome = run(prepare(*task), ndarray_memory())
    return [values.ravel().tolist() for values in outcome]
