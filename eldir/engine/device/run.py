"""Running a batch on a device: its arrays, robots in chunks, and the launches of every iteration."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eldir.engine.device import layout
from eldir.engine.device.kernels import kernels, shared_values
from eldir.engine.device.records import DEVICE, DeviceArrays, DeviceLaunch, DeviceResult, DeviceTask
from eldir.engine.validity import OK
from eldir.errors import EldirError

_logger = logging.getLogger(__name__)

THREADS_STEP = 64
"""The number of threads of a block is a multiple of this."""
_INDEX_LIMIT = 2**31 - 2**16


@dataclass(frozen=True)
class DeviceMemory:
    """Where arrays are put, and how many values of a history there is room for."""

    array: Callable[[NDArray], Any]
    """Puts an array where kernels read it."""
    empty: Callable[[int, Any], Any]
    to_numpy: Callable[[Any], NDArray]
    history_values: int
    order: int = DEVICE


def numpy_memory(order: int, history_values: int = _INDEX_LIMIT) -> DeviceMemory:
    """The memory of kernels that run on the CPU, thread by thread."""
    return DeviceMemory(lambda a: a, np.zeros, lambda a: a, history_values, order)


def run(task: DeviceTask, memory: DeviceMemory) -> DeviceResult:
    """Computes all robots, as many at a time as the history has room for. Raises `EldirError` where one robot
    has no room."""
    real = task.weights.dtype
    robots, iterations = len(task.sizes), task.settings.iterations
    rows, chunks = _chunks(task, memory)
    shared = 0
    if memory.order != DEVICE:
        shared = max(c.robots * shared_values(c.threads) for c in chunks)
    put, empty = memory.array, memory.empty
    _logger.info("%d robots, at most %d at the same time", robots, max(c.robots for c in chunks))
    launch = DeviceLaunch(
        workers=0, first=0, order=memory.order, settings=task.settings, scene=task.scene, rule=task.rule,
        ground=task.ground._replace(
            segments=put(task.ground.segments), cell_segment=put(task.ground.cell_segment)
        ),
        cpgs=put(task.cpgs), offsets=put(rows), arrays=DeviceArrays(*map(put, task.arrays)),
        weights=put(task.weights.copy()), best=put(np.zeros_like(task.weights)),
        transposed=empty(len(task.weights), real), g_weights=empty(len(task.weights), real),
        history=empty(max(c.history for c in chunks), real),
        carry=empty(layout.CARRY * len(task.arrays.mask), real),
        losses=put(np.full(robots * (iterations + 1), np.inf, real)),
        growth=put(np.zeros(robots * (iterations + 1), real)),
        status=put(np.full(robots, OK, np.int32)), shared=empty(max(shared, 1), real),
    )  # fmt: skip
    for chunk in chunks:
        _compute(launch._replace(workers=chunk.robots, first=chunk.first), chunk.threads, task)
    to_numpy = memory.to_numpy
    return DeviceResult(
        to_numpy(launch.losses).reshape(robots, -1),
        to_numpy(launch.status),
        to_numpy(launch.best),
        to_numpy(launch.growth).reshape(robots, -1),
    )


def batch_bytes(task: DeviceTask) -> int:
    """What a batch takes of a device's memory beside the history [bytes]."""
    carry = layout.CARRY * task.arrays.mask.nbytes
    return 4 * task.weights.nbytes + carry + sum(a.nbytes for a in task.arrays) + task.cpgs.nbytes


def _compute(launch: DeviceLaunch, threads: int, task: DeviceTask) -> None:
    run = kernels(task.precision, threads, launch.order == DEVICE)
    steps, iterations = task.settings.steps, task.settings.iterations
    spans = [(first, min(first + task.settings.end, steps)) for first in range(0, steps, task.settings.end)]
    for i in range(iterations + 1):
        now = launch._replace(settings=launch.settings._replace(iteration=i, end=steps))
        run.transpose(now)
        for first, end in spans:
            run.forward(now._replace(settings=now.settings._replace(first=first, end=end)))
        if i < iterations or iterations == 0:
            for first, end in reversed(spans):
                run.reverse(now._replace(settings=now.settings._replace(first=first, end=end)))
            run.update(now)


class _Chunk(NamedTuple):
    """Robots that are computed at the same time, in blocks of the same size."""

    first: int
    robots: int
    threads: int
    history: int
    """Values."""


def _chunks(task: DeviceTask, memory: DeviceMemory) -> tuple[NDArray[np.int32], list[_Chunk]]:
    """The robots' offsets, the largest robot first, and which of them are computed together."""
    n = layout.size(*task.sizes.T.astype(np.int64))
    need = n.step_values * task.settings.steps + layout.WARP
    if need.max() > (max_values := min(memory.history_values, _INDEX_LIMIT)):
        raise EldirError(
            "the history of a robot does not fit on the device",
            code="device.memory",
            expected=f"at most {max_values:,} numbers",
            found=f"{need.max():,} in {task.settings.steps:,} steps",
            remedy="fewer steps, or ELDIR_DEVICE=cpu",
        )
    threads = -(-n.cell_rows // THREADS_STEP) * THREADS_STEP
    order = np.lexsort((-need, -threads))
    history_at, chunks = np.zeros_like(need), []
    for part in _parts(need[order], threads[order], max_values):
        chosen = order[part]
        ends = np.cumsum(need[chosen])
        history_at[chosen] = ends - need[chosen]
        chunks.append(_Chunk(part.start, len(chosen), int(threads[chosen[0]]), int(ends[-1])))
    offsets = np.column_stack([np.arange(len(need)), task.sizes, task.offsets, history_at])
    return offsets[order].astype(np.int32).ravel(), chunks


def _parts(need: NDArray[np.int64], threads: NDArray[np.int64], room: int) -> Iterator[slice]:
    first, used = 0, 0
    for i, values in enumerate(need.tolist()):
        if i > first and (used + values > room or threads[i] != threads[first]):
            yield slice(first, i)
            first, used = i, 0
        used += values
    yield slice(first, len(need))
