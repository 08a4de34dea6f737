"""Running a batch on a device: its arrays, robots in flight, and the launches of every iteration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eldir.engine.device import layout
from eldir.engine.device.block import DEVICE
from eldir.engine.device.kernels import kernels, shared_values
from eldir.engine.device.records import DeviceArrays, DeviceLaunch, DeviceSettings
from eldir.engine.kernels.learning_launch import GroundArrays, SceneNumbers, UpdateRule
from eldir.engine.pack import Batch

WIDTH = 64
"""Blocks have a multiple of so many threads."""
_INDEX_LIMIT = 2**31 - 2**16


class Task(NamedTuple):
    """A batch and what is to be computed of it."""

    precision: str
    settings: DeviceSettings
    scene: SceneNumbers
    rule: UpdateRule
    ground: GroundArrays
    cpgs: NDArray
    sizes: NDArray[np.int32]
    """Masses, motors, cells and reach of every robot, shape (n, 4)."""
    at: NDArray[np.int32]
    """Offsets of its cells, masses, motors and weights, shape (n, 4)."""
    arrays: DeviceArrays
    weights: NDArray


class Outcome(NamedTuple):
    losses: NDArray
    status: NDArray[np.int32]
    best: NDArray


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
    """Computes all robots, as many at a time as the history has room for."""
    real = task.weights.dtype
    robots, iterations = len(task.sizes), task.settings.iterations
    put = memory.array
    rows, flights = _flights(task, memory)
    most = max(f.history for f in flights)
    shared = 0
    if memory.order != DEVICE:
        shared = max(f.robots * shared_values(task.precision, f.threads) for f in flights)
    launch = DeviceLaunch(
        workers=0, first=0, settings=task.settings, scene=task.scene, rule=task.rule,
        ground=task.ground._replace(
            segments=put(task.ground.segments), cell_segment=put(task.ground.cell_segment)
        ),
        cpgs=put(task.cpgs), places=put(rows), arrays=DeviceArrays(*(put(a) for a in task.arrays)),
        weights=put(task.weights.copy()), best=put(np.zeros_like(task.weights)),
        turned=memory.empty(len(task.weights), real), g_weights=memory.empty(len(task.weights), real),
        history=memory.empty(most, real),
        carried=memory.empty(layout.STATE * len(task.arrays.mask), real),
        losses=put(np.full(robots * (iterations + 1), np.inf, real)),
        status=put(np.full(robots, -1, np.int32)), shared=memory.empty(max(shared, 1), real),
    )  # fmt: skip
    for flight in flights:
        _fly(launch._replace(workers=flight.robots, first=flight.first), flight.threads, task, memory.order)
    back = memory.back
    return Outcome(back(launch.losses).reshape(robots, -1), back(launch.status), back(launch.best))


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


def _flights(task: Task, memory: Memory) -> tuple[NDArray[np.int32], list[_Flight]]:
    """The robots' places, the largest first, and which of them are computed together."""
    n = layout.Size(*(np.array(a) for a in layout.size(*task.sizes.T.astype(np.int64))))
    need = n.step_values * task.settings.steps + layout.WARP
    threads = -(-n.cell_rows // WIDTH) * WIDTH
    order = np.lexsort((-need, -threads))
    history_at, flights = np.zeros(len(need), np.int64), []
    for part in _parts(need[order], threads[order], memory.history_values):
        chosen = order[part]
        ends = np.cumsum(need[chosen])
        history_at[chosen] = ends - need[chosen]
        flights.append(_Flight(part.start, len(chosen), int(threads[chosen[0]]), int(ends[-1])))
    rows = np.column_stack([np.arange(len(need)), task.sizes, task.at, history_at])
    return np.ascontiguousarray(rows[order].astype(np.int32)).ravel(), flights


def _parts(need: NDArray[np.int64], threads: NDArray[np.int64], room: int) -> Iterator[slice]:
    first, used = 0, 0
    for i, values in enumerate(need.tolist()):
        if i > first and (used + values > room or threads[i] != threads[first]):
            yield slice(first, i)
            first, used = i, 0
        used += values
    yield slice(first, len(need))


def task_of(
    batch: Batch, precision: str, settings: DeviceSettings, scene: SceneNumbers, rule: UpdateRule,
    ground: GroundArrays, cpgs: NDArray,
) -> Task:  # fmt: skip
    starts = (batch.cell_at, batch.mass_at, batch.motor_at, batch.weight_at)
    arrays = DeviceArrays(
        batch.own, batch.start, batch.reference, batch.velocity, batch.mask, batch.cell, batch.motor,
        batch.rest_length, batch.stiffness_dt,
    )  # fmt: skip
    return Task(
        precision, settings, scene, rule, ground, cpgs, np.stack(batch.counts, axis=1),
        np.stack([at[:-1] for at in starts], axis=1), arrays, batch.weights,
    )  # fmt: skip
