"""The engine, in the benchmark's terms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.task import Task
from eldir.benchmark.measurement import limit_threads
from eldir.core.kernels import Precision
from eldir.core.records import FloatArray
from eldir.engine.batch import BatchConfig, BatchResult, prepare


def learning(task: Task, precision: Precision, threads: int) -> Callable[[], BatchResult]:
    """A call learns once, with all passes that `eldir.learn` does. Packing is not counted."""
    with limit_threads(threads):
        return prepare(
            task.bodies,
            task.controllers,
            task.scene.replace(precision=precision),
            config=BatchConfig(iterations=task.iterations, backward=True, update_length=task.update_length),
        )


def first_losses(task: Task, precision: Precision) -> FloatArray:
    """Losses before learning [m], shape (n,)."""
    return np.asarray(learning(task, precision, 1)().losses[:, 0], np.float64)
