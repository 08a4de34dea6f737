"""Learning on a device that the process started before: the engine's packing, kernels and launches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from eldir.engine import batch as host
from eldir.engine.compiler import ti
from eldir.engine.device.records import DeviceSettings
from eldir.engine.device.run import Memory, Task, run, task_of
from eldir.engine.kernels.learning_launch import GroundArrays, SceneNumbers, UpdateRule
from eldir.lattice import Lattice
from eldir.physics import physics_of
from eldir.scene import SOFTENING, Scene
from tests.eldir.engine.random_robots import robots

LENGTH = 0.1
"""Of an update."""
PAPER = [13, 22]


def some_scene(precision: str, steps: int) -> Scene:
    return Scene(steps=steps, precision=precision, contact="no-slip", integrator="paper")


def in_ndarrays() -> Memory:
    """The memory of the device."""

    def array(a: NDArray) -> object:
        made = ti.ndarray(
            ti.i32 if a.dtype == np.int32 else getattr(ti, f"f{8 * a.itemsize}"), (max(len(a), 1),)
        )
        if len(a):
            made.from_numpy(np.ascontiguousarray(a))
        return made

    return Memory(array, lambda n, kind: array(np.zeros(n, kind)), lambda a: a.to_numpy(), 2**28)


def prepare(
    precision: str, steps: int, count: int, iterations: int, span: int, seed: int, size: list[int]
) -> Task:
    """`count` random robots of a lattice of `size`. A launch computes at most `span` steps."""
    scene = some_scene(precision, steps)
    bodies, brains = robots(Lattice(*size), count, seed, scene)
    packed = host.pack(bodies, brains, scene, physics_of(bodies, scene, None))
    ground = host.pack_ground(scene, True)
    settings = DeviceSettings(
        steps=steps, first=0, end=span, window=steps, iteration=0, iterations=iterations, backward=1,
        contact=host._contact(scene, False), staggered=0, physical=0, listening=1, controlling=1, stopping=1,
    )  # fmt: skip
    numbers = SceneNumbers(
        dt=scene.dt, actuation=scene.actuation, sense=host._SENSE, softening=SOFTENING,
        resting=host._RESTING * scene.dt, tiny=host._TINY,
    )  # fmt: skip
    arrays = GroundArrays(
        level=ground.level, top=ground.top, segments=ground.segments, grid_from=ground.grid_from,
        cells_per_m=ground.cells_per_m, cell_segment=ground.cell_segment,
        last=len(ground.segments) // host.contact.SEGMENT - 1,
    )  # fmt: skip
    rule = UpdateRule(length=LENGTH, bias_gain=1.0, least_gradient=host._LEAST_GRADIENT)
    return task_of(packed, precision, settings, numbers, rule, arrays, host.pack_cpgs(scene))


def learn(*task: object) -> list[list[float]]:
    """The arguments are those of `prepare`. Losses, status, and best weights or gradients, flat."""
    outcome = run(prepare(*task), in_ndarrays())
    return [values.ravel().tolist() for values in outcome]


def learn_all(tasks: list[list[object]]) -> list[list[list[float]]]:
    """Several, with the same kernels."""
    return [learn(*task) for task in tasks]
