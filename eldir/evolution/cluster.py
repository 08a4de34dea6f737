"""Evolution on many machines: parts of a generation as tasks of a Ray cluster.

What a robot learns, or how far it walks, depends on its body and its seed alone. Parts may therefore finish
in any order, on any node, and may be repeated where a worker died.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Any

import numpy as np

from eldir.core.records import FloatArray
from eldir.core.version import source_digest
from eldir.engine.device.process import chosen_device
from eldir.errors import EldirError, InputError, MissingDependencyError
from eldir.evolution.loop import SHARD, Shard
from eldir.evolution.population import LearningOutcome
from eldir.evolution.printed.search import Evaluation
from eldir.evolution.printed.trials import Trial
from eldir.parameters.robot import RobotParameters

_logger = logging.getLogger(__name__)

_RETRIES = 5  # of a shard whose worker died
_SHARDS_EACH = 4
_AHEAD = 2  # shards for every process, so that none waits for the next


class Cluster:
    """Trains and simulates on a Ray cluster, with one process for every `ELDIR_THREADS` cores. Without that
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
        self._learn, self._evaluate = on_workers(_learn), on_workers(_evaluate)

    def robots_at_once(self, robots: int) -> int:
        return shard_size(robots, self.processes, self.threads)

    def __call__(self, shards: Iterable[Shard]) -> Iterator[tuple[Shard, LearningOutcome]]:
        waiting = iter(shards)
        running: dict[Any, Shard] = {}
        try:
            while True:
                for shard in islice(waiting, _AHEAD * self.processes - len(running)):
                    running[self._learn.remote(shard, self.threads, source_digest())] = shard
                if not running:
                    return
                (done,), _ = self._ray.wait(list(running), num_returns=1)
                yield running.pop(done), self._get(done)
        finally:  # the caller wants no more, or something failed
            for task in running:
                self._ray.cancel(task, force=True)

    def evaluate(self, kind: Evaluation, trials: Sequence[Trial], nominal: RobotParameters) -> FloatArray:
        """One row for each trial of printed robots (`eldir.evolution.printed.search.Evaluator`)."""
        parts = np.array_split(np.arange(len(trials)), min(len(trials), _SHARDS_EACH * self.processes))
        tasks = [
            self._evaluate.remote(kind, [trials[i] for i in part], nominal, self.threads, source_digest())
            for part in parts
        ]
        try:
            return np.concatenate([self._get(task) for task in tasks])
        except BaseException:
            for task in tasks:
                self._ray.cancel(task, force=True)
            raise

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
    """Robots in a shard: every process gets a few shards, so that all end together, and little work is lost
    with a worker."""
    return max(threads, min(SHARD * threads, robots // (_SHARDS_EACH * processes)))


def _learn(shard: Shard, threads: int, source: str) -> LearningOutcome:
    """Train a shard on a worker."""
    _prepare(threads, source)
    return shard.learn()


def _evaluate(
    kind: Evaluation, trials: Sequence[Trial], nominal: RobotParameters, threads: int, source: str
) -> FloatArray:
    """Run trials of printed robots on a worker."""
    _prepare(threads, source)
    return kind(trials, nominal)


def _prepare(threads: int, source: str) -> None:
    """Raises `EldirError` where the worker runs other code than `source`."""
    if source_digest() != source:
        raise EldirError(
            f"{os.uname().nodename} runs other code ({source_digest()})",
            expected=source,
            remedy="install the same version of eldir on every node",
        )
    os.environ["ELDIR_THREADS"] = str(threads)
