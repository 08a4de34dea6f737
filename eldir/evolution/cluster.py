"""Evolution on many machines: parts of a generation as tasks of a Ray cluster.

What a robot learns, or how far it walks, depends on its body and its seed alone. Parts may therefore finish
in any order, on any node, and may be repeated where a worker died.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

from eldir.core.version import source_digest
from eldir.engine.device.process import chosen_device
from eldir.errors import EldirError, InputError, MissingDependencyError
from eldir.evolution.problem import Batch, Part
from eldir.evolution.workers import SHARD

_logger = logging.getLogger(__name__)

_RETRIES = 5  # of a part whose worker died
_SHARDS_EACH = 4
_AHEAD = 2  # parts for every process, so that none waits for the next


class Cluster:
    """Evaluates on a Ray cluster, with one process for every `ELDIR_THREADS` cores. Without that
    variable, every process has as many cores as the smallest node."""

    def __init__(self) -> None:
        if (device := chosen_device()) != "cpu":
            raise InputError(
                "a cluster learns on processors only",
                code="cluster.device",
                found=f"the device {device}",
                remedy="use --device cpu, or unset ELDIR_DEVICE",
            )
        try:
            import ray
        except ImportError:
            raise MissingDependencyError(
                "--cluster needs Ray, which is not installed here",
                remedy="install eldir with its extra: pip install 'eldir[cluster]'",
            ) from None
        self._ray: Any = ray
        if not ray.is_initialized():
            try:  # the cluster that RAY_ADDRESS or `ray start` names, or a new one on this machine
                ray.init(log_to_driver=False, logging_level=logging.ERROR, include_dashboard=None)
            except (ConnectionError, ValueError, RuntimeError) as error:
                raise EldirError(
                    "no Ray cluster can be reached",
                    found=str(error).partition("\n")[0],
                    remedy="start one with ray start, or unset RAY_ADDRESS to use this machine alone",
                ) from None
        cores = [int(n["Resources"].get("CPU", 0)) for n in ray.nodes() if n["Alive"]]
        cores = [c for c in cores if c]
        if not cores:
            raise EldirError("the Ray cluster has no CPUs", remedy="start its nodes with --num-cpus")
        self.threads = min(int(os.environ.get("ELDIR_THREADS") or min(cores)), max(cores))
        """Threads of one process."""
        self.processes = sum(c // self.threads for c in cores)
        """Number of processes that learn at the same time."""
        _logger.info("Ray cluster: %d processes with %d threads each", self.processes, self.threads)
        on_workers = ray.remote(num_cpus=self.threads, max_retries=_RETRIES)
        self._run = on_workers(_run)

    def part_size(self, batch: Batch, tasks: int) -> int:
        if batch.has_long_tasks:
            return shard_size(tasks, self.processes, self.threads)
        return -(-tasks // (_SHARDS_EACH * self.processes))

    def __call__(self, parts: Iterable[Part]) -> Iterator[tuple[Part, Any]]:
        waiting = iter(parts)
        running: dict[Any, Part] = {}
        try:
            while True:
                for part in islice(waiting, _AHEAD * self.processes - len(running)):
                    running[self._run.remote(part, self.threads, source_digest())] = part
                if not running:
                    return
                (done,), _ = self._ray.wait(list(running), num_returns=1)
                yield running.pop(done), self._get(done)
        finally:  # the caller wants no more, or something failed
            for task in running:
                self._ray.cancel(task, force=True)

    def _get(self, task: Any) -> Any:
        try:
            return self._ray.get(task)
        except self._ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, EldirError):
                raise error.cause from None
            raise
        except self._ray.exceptions.RaySystemError as error:
            raise EldirError("the Ray cluster failed", found=str(error).partition("\n")[0]) from None
        except self._ray.exceptions.WorkerCrashedError:
            raise EldirError(
                f"workers died {_RETRIES + 1} times on the same robots",
                remedy="check the free memory of the cluster's nodes, and set ELDIR_THREADS lower",
            ) from None

    def close(self) -> None:
        """Leave the cluster. A cluster that was started for this process ends."""
        self._ray.shutdown()


def shard_size(robots: int, processes: int, threads: int) -> int:
    """Long tasks in a part: every process gets a few parts, so that all end together, and little work is
    lost with a worker."""
    return max(threads, min(SHARD * threads, robots // (_SHARDS_EACH * processes)))


def _run(part: Part, threads: int, source: str) -> Any:
    """Evaluate a part on a worker. Raises `EldirError` where it runs other code than `source`."""
    if source_digest() != source:
        raise EldirError(
            f"{os.uname().nodename} runs other code ({source_digest()})",
            expected=source,
            remedy="install the same version of eldir on every node",
        )
    os.environ["ELDIR_THREADS"] = str(threads)
    return part.run()
