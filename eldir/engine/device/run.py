"""Running a batch on a device: its arrays, robots in flight, and the launches of every iteration."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eldir.engine.device import layout
from eldir.engine.device.block import DEVICE
from eldir.engine.device.kernels import kernels, robots_beside, shared_values
from eldir.engine.device.records import DeviceArrays, DeviceLaunch, Outcome, Task
from eldir.errors import EldirError

_logger = logging.getLogger(__name__)

import os
WIDTH = int(os.environ.get("WIDTH", "64"))
"""Blocks have a multiple of so many threads."""
_INDEX_LIMIT = 2**31 - 2**16


@dataclass(frozen=True)
class Memory:
    """Where arrays are put, and how many values of a history there is room for."""

    array: Callable[[NDArray], Any]
    """Puts an array where kernels read it."""
    empty: Callable[[int, Any], Any]
    back: Callable[[Any], NDArray]
    history_values: int
    order: int = DEVICE


def in_numpy(order: int, history_values: int = _INDEX_LIMIT) -> Memory:
    """The memory of kernels that run on the CPU, thread by thread."""
    return Memory(lambda a: a, lambda n, kind: np.zeros(n, kind), lambda a: a, history_values, order)


def run(task: Task, memory: Memory) -> Outcome:
    """Computes all robots, as many at a time as the history has room for. Raises `EldirError` where one robot
    has no room."""
    real = task.weights.dtype
    robots, iterations = len(task.sizes), task.settings.iterations
    rows, flights = _flights(task, memory)
    shared = 0
    if memory.order != DEVICE:
        shared = max(f.robots * shared_values(f.threads) for f in flights)
    put, empty = memory.array, memory.empty
    stuffed = DeviceArrays(*(_longer(a, n) for a, n in zip(task.arrays, _STUFFING, strict=True)))
    stuffed.cell[-_STUFFING.cell :] = layout.WARP // 2 - 1
    weights = _longer(task.weights, _STUFFING_WEIGHTS)
    _logger.info("%d robots, at most %d at the same time", robots, max(f.robots for f in flights))
    launch = DeviceLaunch(
        workers=0, first=0, settings=task.settings, scene=task.scene, rule=task.rule,
        ground=task.ground._replace(
            segments=put(task.ground.segments), cell_segment=put(task.ground.cell_segment)
        ),
        cpgs=put(task.cpgs), places=put(rows), arrays=DeviceArrays(*map(put, stuffed)),
        weights=put(weights), best=put(np.zeros_like(weights)),
        turned=empty(len(weights), real), g_weights=empty(len(weights), real),
        history=empty(max(f.history for f in flights), real),
        carried=empty(layout.STATE * len(stuffed.mask), real),
        losses=put(np.full((robots + 1) * (iterations + 1), np.inf, real)),
        status=put(np.full(robots + 1, -1, np.int32)), shared=empty(max(shared, 1), real),
    )  # fmt: skip
    for flight in flights:
        _fly(launch._replace(workers=flight.robots, first=flight.first), flight.threads, task, memory.order)
    losses = memory.back(launch.losses).reshape(robots + 1, -1)
    best = memory.back(launch.best)[: len(task.weights)]
    return Outcome(losses[:robots], memory.back(launch.status)[:robots], best)


def batch_bytes(task: Task) -> int:
    """What a batch takes of a device's memory beside the history [bytes]."""
    carried = layout.STATE * task.arrays.mask.nbytes
    return 4 * task.weights.nbytes + carried + sum(a.nbytes for a in task.arrays) + task.cpgs.nbytes


def _longer(values: NDArray[Any], count: int) -> NDArray[Any]:
    return np.concatenate([values, np.zeros(count, values.dtype)])


def _fly(launch: DeviceLaunch, threads: int, task: Task, order: int) -> None:
    run = kernels(task.precision, threads, order)
    steps, iterations, backward = task.settings.steps, task.settings.iterations, task.settings.backward
    spans = [(first, min(first + task.settings.end, steps)) for first in range(0, steps, task.settings.end)]
    for i in range(iterations + 1):
        now = launch._replace(settings=launch.settings._replace(iteration=i, end=steps))
        run.transpose(now)
        for first, end in spans:
            run.forward(now._replace(settings=now.settings._replace(first=first, end=end)))
        if backward and (i < iterations or iterations == 0):
            for first, end in reversed(spans):
                run.reverse(now._replace(settings=now.settings._replace(first=first, end=end)))
            run.update(now)


class _Flight(NamedTuple):
    """Robots that are computed at the same time, in blocks of the same size."""

    first: int
    robots: int
    threads: int
    history: int
    """Values."""


_STUFFING = DeviceArrays(
    own=3, start=32, reference=32, velocity=32, mask=16, cell=2, motor=0, rest_length=48, stiffness_dt=48
)
"""Values of a robot of one mass without springs, which fills the last block of a flight."""
_STUFFING_SIZE = (1, 0, 16, 1)
_STUFFING_WEIGHTS = layout.size(*_STUFFING_SIZE).weights


def _flights(task: Task, memory: Memory) -> tuple[NDArray[np.int32], list[_Flight]]:
    """The robots' places, the largest first, and which of them are computed together: whole blocks."""
    a, robots = task.arrays, len(task.sizes)
    ends = len(a.mask), len(a.cell), len(a.motor), len(task.weights)
    sizes = np.vstack([task.sizes, _STUFFING_SIZE]).astype(np.int64)
    places = np.column_stack([np.arange(robots + 1), sizes, np.vstack([task.at, ends])])
    n = layout.size(*sizes.T)
    need = n.step_values * task.settings.steps + layout.WARP
    if need.max() > (most := min(memory.history_values, _INDEX_LIMIT)):
        raise EldirError(
            "the history of a robot does not fit on the device",
            code="device.memory",
            expected=f"at most {most:,} numbers",
            found=f"{need.max():,} in {task.settings.steps:,} steps",
            remedy="fewer steps, or ELDIR_DEVICE=cpu",
        )
    threads = -(-n.cell_rows // WIDTH) * WIDTH
    spare = int(need[-1]) * robots_beside(task.precision, WIDTH)
    order = np.lexsort((-need[:-1], -threads[:-1]))
    rows, flights = [], []
    for part in _parts(need[order], threads[order], most - spare):
        chosen, block = order[part], int(threads[order[part.start]])
        beside = robots_beside(task.precision, block) if memory.order == DEVICE else 1
        chosen = np.append(chosen, np.full(-len(chosen) % beside, robots))
        used = np.cumsum(need[chosen])
        rows.append(np.column_stack([places[chosen], used - need[chosen]]))
        flights.append(_Flight(sum(map(len, rows[:-1])), len(chosen), block, int(used[-1])))
    return np.concatenate(rows).astype(np.int32).ravel(), flights


def _parts(need: NDArray[np.int64], threads: NDArray[np.int64], room: int) -> Iterator[slice]:
    first, used = 0, 0
    for i, values in enumerate(need.tolist()):
        if i > first and (used + values > room or threads[i] != threads[first]):
            yield slice(first, i)
            first, used = i, 0
        used += values
    yield slice(first, len(need))
