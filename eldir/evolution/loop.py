"""Evolving a run: the robots of a generation learn in shards, every shard is saved when it is done, and then
the search selects.

What a robot learns depends on its body and its seed alone. The order, the machine and interruptions make no
difference.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Protocol, Self

import numpy as np

from eldir.controller import Controller
from eldir.core.records import FloatArray, IntArray
from eldir.engine.device.process import chosen_device, device_count
from eldir.errors import InputError
from eldir.evolution import tables
from eldir.evolution.population import LearningOutcome, Robots
from eldir.evolution.run_folder import RunFolder
from eldir.evolution.search import EvolutionConfig, Search
from eldir.genotype import stack
from eldir.learning import learn
from eldir.morphology import Morphology
from eldir.scene import Scene
from eldir.training.configuration import TrainingConfig
from eldir.training.randomisation import Randomisation

_logger = logging.getLogger(__name__)
SHARD = 8
"""Robots for each thread in one shard, and between two checks for Ctrl-C: about a second of the paper's
robots."""
DEVICE_SHARD = 2048
"""The same for a device: some seconds, and more robots than run there at the same time."""


@dataclass(frozen=True)
class Shard:
    """Some robots of a generation."""

    index: IntArray
    """Indices of the robots in the generation, shape (n,)."""
    bodies: tuple[Morphology, ...]
    seeds: tuple[int, ...]
    scene: Scene
    iterations: int
    controllers: tuple[Controller, ...] | None
    """Initial weights. None: random weights from the seeds."""
    training: TrainingConfig
    randomisation: Randomisation | None

    def learn(self) -> LearningOutcome:
        """Train these robots in this process."""
        return learn(
            self.bodies, self.scene, self.iterations, self.seeds, self.controllers,
            training=self.training, randomisation=self.randomisation,
        )  # fmt: skip


class Trainer(Protocol):
    """Trains shards, in any order: `LocalTrainer` on this machine, `cluster.Cluster` on many."""

    def robots_at_once(self, robots: int) -> int:
        """The size of a shard, if so many robots have to learn."""

    def __call__(self, shards: Iterable[Shard]) -> Iterator[tuple[Shard, LearningOutcome]]:
        """Train the shards; yields each one with its outcome, in the order in which they finish."""


@dataclass
class _GenerationOutcome:
    """The outcomes of a generation that are known so far."""

    losses: FloatArray
    """Losses [m], shape (n, iterations + 1)."""
    chaotic_updates: IntArray
    rounded_updates: IntArray
    trained: dict[int, Controller] = field(default_factory=dict)

    @classmethod
    def unknown(cls, n: int, iterations: int) -> Self:
        """Of a generation of n robots, none of which has learned."""
        return cls(np.zeros((n, iterations + 1)), np.full(n, -1), np.full(n, -1))

    @property
    def missing(self) -> IntArray:
        """Indices of the robots that have still to learn."""
        return np.array([i for i in range(len(self.losses)) if i not in self.trained], np.int64)

    @property
    def controllers(self) -> list[Controller]:
        """The controllers of all robots, in order."""
        return [self.trained[i] for i in range(len(self.losses))]

    def add(
        self,
        index: IntArray,
        losses: FloatArray,
        controllers: Sequence[Controller],
        chaotic: IntArray,
        rounded: IntArray,
    ) -> None:
        self.losses[index] = losses
        self.chaotic_updates[index], self.rounded_updates[index] = chaotic, rounded
        self.trained.update(zip(index.tolist(), controllers, strict=True))


class LocalTrainer:
    """Trains on this machine, with all of its threads."""

    def __init__(self) -> None:
        from eldir.engine.threads import worker_threads

        self._robots_at_once = SHARD * worker_threads()

    def robots_at_once(self, robots: int) -> int:
        return self._robots_at_once

    def __call__(self, shards: Iterable[Shard]) -> Iterator[tuple[Shard, LearningOutcome]]:
        for shard in shards:
            yield shard, shard.learn()


class DeviceTrainer:
    """Trains on the devices of this machine: while shards learn there, the next one is prepared here."""

    def __init__(self, devices: int) -> None:
        self._devices = devices

    def robots_at_once(self, robots: int) -> int:
        return max(min(DEVICE_SHARD, robots // self._devices), 1)

    def __call__(self, shards: Iterable[Shard]) -> Iterator[tuple[Shard, LearningOutcome]]:
        waiting, running = iter(shards), dict[Future[LearningOutcome], Shard]()
        at_once = self._devices + 1
        with ThreadPoolExecutor(at_once) as threads:
            try:
                while True:
                    for shard in islice(waiting, at_once - len(running)):
                        running[threads.submit(shard.learn)] = shard
                    if not running:
                        return
                    for done in wait(running, return_when=FIRST_COMPLETED).done:
                        yield running.pop(done), done.result()
            finally:  # the caller wants no more, or something failed
                for task in running:
                    task.cancel()


def make_local_trainer(run: RunFolder) -> Trainer:
    """The trainer for this machine, by `ELDIR_DEVICE`. Logs a warning where a run began on another device."""
    device = chosen_device()
    if device != run.device:
        _logger.warning(
            f"{run.path} began to learn on {run.device} and continues on {device}: "
            "results differ in the last digits from those of one device"
        )
    _logger.info("robots learn on %s", device)
    return LocalTrainer() if device == "cpu" else DeviceTrainer(device_count())


def evolve(
    config: EvolutionConfig, folder: Path | str, progress: Callable[[int, float], None] | None = None
) -> RunFolder:
    """Evolve a population into a new run folder, on this machine, to the last generation.

    `progress` is called after every generation with its number and the best fitness [m]. The same
    configuration gives the same bytes. Raises `EldirError` where the folder exists already, or where no robot
    of the first generation is stable. An interrupted run goes on with `resume`; one that fails before a robot
    has learned leaves no folder.

        from eldir.evolution import EvolutionConfig, evolve, load_run

        run = evolve(EvolutionConfig(Lattice(6, 11), population=16, generations=3, max_active=2), "run")
        best = load_run(run.path)[0]
    """
    run = RunFolder.create(Path(folder), config)
    with run.remove_if_empty():
        return _run_to_end(run, progress)


def resume(folder: Path | str, progress: Callable[[int, float], None] | None = None) -> RunFolder:
    """Go on with an interrupted run to its last generation; it ends with the same bytes as one that was not
    interrupted. `progress` as in `evolve`."""
    return _run_to_end(RunFolder.open(Path(folder)), progress)


def _run_to_end(run: RunFolder, progress: Callable[[int, float], None] | None) -> RunFolder:
    with run.locked():
        search = run.restore()
        reported = search.generation

        def saved(learned: int) -> None:
            nonlocal reported
            if progress is not None and search.generation > reported and search.survivors is not None:
                reported = search.generation
                progress(reported - 1, float(search.survivors.fitness()[0]))

        run_generations(run, search, make_local_trainer(run), progress=saved)
    return run


def run_generations(
    run: RunFolder,
    search: Search,
    trainer: Trainer,
    stopped: Callable[[], bool] = lambda: False,
    progress: Callable[[int], None] = lambda learned: None,
) -> None:
    """Go on until the last generation is saved, or `stopped` returns true. `progress` is called with the
    number of robots of the present generation that have learned, and with 0 when the survivors are selected.
    A generation is saved while the next one learns. The caller holds the run's lock."""
    with ThreadPoolExecutor(1) as background:
        saved: Future[None] | None = None
        while not (search.finished or stopped()):
            robots = search.ask()
            learned = _generation(run, search, robots, trainer, stopped, progress)
            if saved is not None:
                saved.result()
            if learned is None:
                return
            # While the next robots learn: the weights of ten thousand take seconds to write.
            saved = background.submit(run.save, search, search.tell(robots, learned))
            progress(0)
        if saved is not None:
            saved.result()


def _generation(
    run: RunFolder,
    search: Search,
    robots: Robots,
    trainer: Trainer,
    stopped: Callable[[], bool],
    progress: Callable[[int], None],
) -> _GenerationOutcome | None:
    """The outcomes of all robots of a generation, or None if it was stopped before the last one."""
    n = len(robots.ids)
    known = _GenerationOutcome.unknown(n, run.config.iterations)
    for path in run.parts(search.generation):
        ids, losses, controllers, chaotic, rounded = tables.read_outcome(path)
        index = ids - robots.ids[0]
        if not (index.min() >= 0 and index.max() < n and losses.shape[1] == known.losses.shape[1]):
            error = InputError("robots of another generation")
            raise tables.damaged(path, "robots of this generation", error)
        known.add(index, losses, controllers, chaotic, rounded)
    progress(len(known.trained))
    size = trainer.robots_at_once(len(known.missing))
    for shard, o in trainer(_shards(search, robots, known.missing, size)):
        known.add(shard.index, o.losses, o.controllers, o.chaotic_updates, o.rounded_updates)
        if len(known.trained) < n:  # the last shard is saved with its generation
            run.save_part(search.generation, robots.ids[shard.index], o)
        progress(len(known.trained))
        if len(known.trained) < n and stopped():
            return None
    return known


def _shards(search: Search, robots: Robots, missing: IntArray, size: int) -> Iterator[Shard]:
    """Robots of about equal size together, the largest first, so that threads and machines end together."""
    config = search.config
    triangles, _ = stack(robots.genotypes)
    springs = config.lattice.expressed_springs(triangles).sum(axis=1)
    largest_first = missing[np.argsort(-springs[missing], kind="stable")]
    for k in range(0, len(largest_first), size):
        index = largest_first[k : k + size]
        some = robots.take(index)
        bodies = some.morphologies(config.lattice)
        initial = search.initial_controllers(some, bodies)
        yield Shard(
            index,
            tuple(bodies),
            tuple(some.seeds.tolist()),
            config.scene,
            config.iterations,
            None if initial is None else tuple(initial),
            config.training,
            config.randomisation,
        )
