"""What evaluates the parts of a batch: this machine's processors, its devices; a cluster is in `cluster`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import islice
from typing import Any, Protocol

from eldir.core.kernels import Device
from eldir.engine.device.process import device_count
from eldir.evolution.problem import Batch, Part

SHARD = 8
"""Long tasks for each thread in one part, and between two checks for Ctrl-C: about a second of the paper's
robots."""
DEVICE_SHARD = 2048
"""The same for a device: some seconds, and more robots than run there at the same time."""


class Workers(Protocol):
    """Evaluates parts, in any order: on this machine, or on many (`cluster.Cluster`)."""

    def part_size(self, batch: Batch, tasks: int) -> int:
        """The size of a part, if so many tasks of a batch are left."""

    def __call__(self, parts: Iterable[Part]) -> Iterator[tuple[Part, Any]]:
        """Evaluate the parts; yields each one with its result, in the order in which they finish."""


class LocalWorkers:
    """Evaluates on this machine, with all of its threads."""

    def part_size(self, batch: Batch, tasks: int) -> int:
        from eldir.engine.threads import worker_threads

        return SHARD * worker_threads() if batch.has_long_tasks else tasks

    def __call__(self, parts: Iterable[Part]) -> Iterator[tuple[Part, Any]]:
        for part in parts:
            yield part, part.run()


class DeviceWorkers:
    """Evaluates on the devices of this machine: while parts run there, the next one is prepared here."""

    def __init__(self, devices: int) -> None:
        self._devices = devices

    def part_size(self, batch: Batch, tasks: int) -> int:
        return max(min(DEVICE_SHARD, tasks // self._devices), 1) if batch.has_long_tasks else tasks

    def __call__(self, parts: Iterable[Part]) -> Iterator[tuple[Part, Any]]:
        waiting, running = iter(parts), dict[Future[Any], Part]()
        at_once = self._devices + 1
        with ThreadPoolExecutor(at_once) as threads:
            try:
                while True:
                    for part in islice(waiting, at_once - len(running)):
                        running[threads.submit(part.run)] = part
                    if not running:
                        return
                    for done in wait(running, return_when=FIRST_COMPLETED).done:
                        yield running.pop(done), done.result()
            finally:  # the caller wants no more, or something failed
                for task in running:
                    task.cancel()


def workers_on(device: Device) -> Workers:
    """The workers of this machine on that kind of device."""
    return LocalWorkers() if device == "cpu" else DeviceWorkers(device_count())
