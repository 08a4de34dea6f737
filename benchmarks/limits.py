"""`python -m benchmarks.limits [COMPILER]`: robot-iterations a second that each limit of an H100 allows, from
machine code and counted numbers.

A robot-iteration is one forward and one reverse pass over all steps, and the update. Kernels run one after
another, so their times add up. Within a kernel the slowest limit counts.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np

from benchmarks.assembly import AssembledKernel, Launch, assemble, launch_on_stub
from benchmarks.machine_code import L1, L2, Loop, read_loops, step_loops, warp_cycles
from eldir.controller import HIDDEN
from eldir.core.kernels import compiler_name
from eldir.engine.grid import FAMILIES
from eldir.errors import EldirError

NUMBER = 4
"""Bytes of a number (f32)."""


class Gpu(NamedTuple):
    """What a whole GPU does, each second where nothing else is said."""

    name: str
    architecture: int
    multiprocessors: int
    clock: float
    """[Hz]."""
    operations: float
    """Additions and multiplications of f32."""
    memory: float
    """Bytes from or to memory (HBM)."""
    cache: float
    """Bytes from the cache of all multiprocessors (L2)."""


H100 = Gpu("H100 SXM", 90, 132, 1.98e9, 67e12, 3.35e12, 5.5e12)
"""NVIDIA's data sheet of the H100 (SXM): 67 TFLOP/s of f32, 3.35 TB/s. The clock follows from these and from
the 128 f32 lanes of each of 132 multiprocessors. The data sheet is silent about L2: 5.5 TB/s were measured by
Chips and Cheese (2023)."""


class Work(NamedTuple):
    """What a kernel does for one robot in one iteration. Numbers are f32."""

    steps: int
    """Times round the loop over steps; 0: the kernel has none."""
    operations: float
    """Additions and multiplications of a step, or of all where there are no steps. So below."""
    loads: float
    """Numbers that threads load from global memory, weights and history."""
    stores: float
    """Numbers that threads store there."""
    memory: float
    """Numbers of these that come from or go to HBM: the history, as caches hold the weights."""
    loop: int = 0
    """Which loop over steps, where a kernel has several."""


LIMITS = ("arithmetic", "HBM", "L2", "L1 and shared memory", "instructions", "occupancy, L1", "occupancy, L2")


def seconds(kernel: AssembledKernel, work: Work, gpu: Gpu = H100) -> dict[str, float]:
    """Time of one robot-iteration in a kernel by each of LIMITS [s], with all multiprocessors full of blocks.

    L2: all numbers come from there. Occupancy: as many blocks as fit run at the same time, and each waits for
    its barriers and results, with all numbers in L1 or all in L2."""
    every = read_loops(kernel)
    body = step_loops(every)[work.loop] if work.steps else every
    required_loads = max(0.0, work.loads / kernel.threads - body.numbers)
    rounds = _rounds(body, required_loads)
    parts = [(body, 1.0), *((loop, rounds) for loop in [*body.walk()][1:] if loop.numbers)]

    def total(counted: Mapping[int, float]) -> float:
        return sum(times * counted[id(part)] for part, times in parts)

    instructions = total({id(part): len(part.own) for part, _ in parts})
    accesses = total({id(part): part.count("LDG", "STG", "LDS", "STS") for part, _ in parts})
    waits = {load: total({id(part): warp_cycles(part.own, load) for part, _ in parts}) for load in (L1, L2)}
    warps = -(-kernel.threads // 32)
    cycle = 1 / (gpu.multiprocessors * gpu.clock)
    each = (
        work.operations / gpu.operations,
        work.memory * NUMBER / gpu.memory,
        (work.loads + work.stores) * NUMBER / gpu.cache,
        accesses * warps * cycle,  # a multiprocessor serves one access of a warp in a cycle
        instructions * warps / 4 * cycle,  # it starts four instructions in a cycle
        waits[L1] / kernel.blocks * cycle,
        waits[L2] / kernel.blocks * cycle,
    )
    return {name: time * max(work.steps, 1) for name, time in zip(LIMITS, each, strict=True)}


def _rounds(body: Loop, required_loads: float) -> float:
    """Rounds of each inner loop that loads numbers, so that a thread loads as many as wanted in all of them.

    An unrolled loop and its remainder count alike: the result is a mean of both."""
    loaded = sum(loop.numbers for loop in [*body.walk()][1:])
    return required_loads / loaded if loaded else 0.0


def table(works: Sequence[tuple[AssembledKernel, Work]], gpu: Gpu = H100) -> Iterator[str]:
    """Lines for a page: robot-iterations a second by each limit, for all kernels together.

    The last two lines take the slowest limit of each kernel, with all numbers in L1 and with all in L2: the
    speed lies between them."""
    times = [seconds(kernel, work, gpu) for kernel, work in works]
    yield f"| limit of one {gpu.name} | robot-iterations a second |"
    yield "| --- | --- |"
    for name in LIMITS:
        yield f"| {name} | {_round(1 / sum(each[name] for each in times))} |"
    for cache, other in (("L1", "L2"), ("L2", "L1")):
        left_out = {f"occupancy, {other}"} | ({"L2"} if cache == "L1" else set())
        slowest = sum(max(time for name, time in each.items() if name not in left_out) for each in times)
        yield f"| all together, numbers in {cache} | {_round(1 / slowest)} |"


def _round(value: float) -> str:
    """Two digits: the rest is no knowledge."""
    return f"{float(f'{value:.2g}'):,.0f}".replace(",", " ")


def works(masses: int, motors: int, cells: int, steps: int) -> tuple[Work, Work, Work, Work]:
    """Work of the four kernels (`eldir.engine.device.kernels`) for a robot of such a size."""
    from eldir.engine.device.layout import STATE, size

    n = size(masses, motors, cells, 0)
    w2 = HIDDEN * motors
    springs = 2 * FAMILIES * cells  # rest length and stiffness
    delta = HIDDEN + motors  # of hidden units and motors
    ahead = Work(
        steps,
        operations=2 * (HIDDEN * n.inputs + w2) + 90 * cells,
        loads=HIDDEN * n.inputs + w2 + delta + springs + 3 * masses,
        stores=n.step_values - HIDDEN,
        memory=n.step_values - HIDDEN,
    )
    back = Work(
        steps,
        operations=2 * (4 * HIDDEN * masses + w2) + 120 * cells,
        loads=4 * HIDDEN * masses + w2 + springs + STATE * cells + delta + 3 * motors,
        stores=delta,
        memory=STATE * cells + 2 * delta,
    )
    rows = n.inputs + n.padded_motors
    update = Work(  # a thread loads 12 numbers of a step for 32 products
        0,
        operations=2 * HIDDEN * rows * steps,
        loads=12 * rows * steps,
        stores=n.weights,
        memory=(rows + 2 * HIDDEN) * steps,
    )
    return Work(0, 0, n.weights, n.weights, 0), ahead, back, update


def launch(threads: int = 128, friction: bool = False) -> None:
    """Launch each of the four kernels, for blocks of so many threads, with a robot of zeros, on a stub."""
    from eldir.engine.device.kernels import kernels
    from eldir.engine.device.records import DeviceLaunch
    from eldir.engine.kernels.contact import FRICTION, NO_SLIP

    for kernel in kernels("f32", threads):
        kernel(_zeros(DeviceLaunch, np.float32, FRICTION if friction else NO_SLIP))


def _zeros(record: Any, real: Any, contact: int) -> Any:
    """A record of kernel arguments: all numbers but `contact` 1, all arrays 0."""

    def value(name: str, hint: Any) -> Any:
        if get_origin(hint) is not Annotated:
            return _zeros(hint, real, contact)
        kind = get_args(hint)[1]
        arrays = {"i32[]": np.int32, "real[]": real}
        constants = {"contact": contact, "staggered": 0, "physics_gradients": 0}
        return np.zeros(64, arrays[kind]) if kind in arrays else constants.get(name, 1)

    hints = get_type_hints(record, include_extras=True)
    return record(*(value(name, hint) for name, hint in hints.items()))


def launch_kernels(compiler: str, folder: Path, threads: int = 128, friction: bool = False) -> list[Launch]:
    """Transpose, forward, reverse, update, as a compiler writes them. Raises: EldirError."""
    launches = launch_on_stub("benchmarks.limits:launch", threads, friction, compiler=compiler, folder=folder)
    return [one for one in launches if one.kernel.startswith("launch_") and one.kernel.endswith("range_for")]


MEAN_ROBOT = {"masses": 83, "motors": 82, "cells": 115}
"""Of random bodies on the paper's lattice of 13 x 22."""


def main(compiler: str = "") -> int:
    """Status 0 if the kernels were assembled."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            launches = launch_kernels(compiler or compiler_name(), Path(folder))
            kernels = assemble(launches, H100.architecture)
            print(*table([*zip(kernels, works(**MEAN_ROBOT, steps=1000), strict=True)]), sep="\n")
    except EldirError as error:
        print(f"benchmarks.limits: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
