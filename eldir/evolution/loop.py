"""Evolving a run: shards of every generation learn, each is kept as soon as it has, then selection.

What a robot learns depends on itself and its seed alone, so that it makes no difference who learns
beside it, in which order, on which machine, or before or after an interruption.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from eldir.controller import Controller
from eldir.core.records import FloatArray, IntArray
from eldir.errors import InputError
from eldir.evolution import tables
from eldir.evolution.population import LearningOutcome, Robots
from eldir.evolution.run_folder import Run
from eldir.evolution.search import Search
from eldir.learning import learn
from eldir.morphology import Morphology
from eldir.scene import Scene
from eldir.training.configuration import Training
from eldir.training.randomisation import Randomisation

SHARD = 8
"""Robots for each thread between two looks at Ctrl-C: about a second of the paper's robots."""


@dataclass(frozen=True)
class Shard:
    """Some robots of a generation."""

    index: IntArray
    """Which, shape (n,)."""
    bodies: tuple[Morphology, ...]
    seeds: tuple[int, ...]
    scene: Scene
    iterations: int
    controllers: tuple[Controller, ...] | None
    """What they start from; None: random weights from their seeds."""
    training: Training
    randomisation: Randomisation | None

    def learn(self) -> LearningOutcome:
        """Teach them here."""
        return learn(
            self.bodies, self.scene, self.iterations, self.seeds, self.controllers,
            training=self.training, randomisation=self.randomisation,
        )  # fmt: skip


class Teacher(Protocol):
    """Has shards learn, in any order; `cluster.Cluster` does it on many machines."""

    def robots_at_once(self, robots: int) -> int:
        """How many robots a shard should have where so many have to learn."""

    def __call__(self, shards: Iterable[Shard]) -> Iterator[tuple[Shard, LearningOutcome]]:
        """Every shard with what it learned, as they come."""


@dataclass
class _Known:
    """What the robots of a generation learned, as far as it is known."""

    losses: FloatArray
    """Shape (n, iterations + 1)."""
    taught: dict[int, Controller] = field(default_factory=dict)

    @property
    def missing(self) -> IntArray:
        """Who has still to learn."""
        return np.array([i for i in range(len(self.losses)) if i not in self.taught], np.int64)

    @property
    def controllers(self) -> list[Controller]:
        """Of all, in order."""
        return [self.taught[i] for i in range(len(self.losses))]

    def add(self, index: IntArray, losses: FloatArray, controllers: Sequence[Controller]) -> None:
        self.losses[index] = losses
        self.taught.update(zip(index.tolist(), controllers, strict=True))


class Here:
    """A teacher: this machine, with all of its threads."""

    def __init__(self) -> None:
        from eldir.engine.runtime import threads

        self._robots_at_once = SHARD * threads()

    def robots_at_once(self, robots: int) -> int:
        return self._robots_at_once

    def __call__(self, shards: Iterable[Shard]) -> Iterator[tuple[Shard, LearningOutcome]]:
        for shard in shards:
            yield shard, shard.learn()


def evolve(
    run: Run,
    search: Search,
    teacher: Teacher,
    stopped: Callable[[], bool] = lambda: False,
    progress: Callable[[int], None] = lambda learned: None,
) -> None:
    """Go on until every generation is told, or `stopped` says so; `progress` is told how many robots
    of the generation under way have learned, and 0 when it is whole."""
    while not (search.finished or stopped()):
        robots = search.ask()
        learned = _generation(run, search, robots, teacher, stopped, progress)
        if learned is None:
            return
        run.save(search, search.tell(robots, learned))
        progress(0)


def _generation(
    run: Run,
    search: Search,
    robots: Robots,
    teacher: Teacher,
    stopped: Callable[[], bool],
    progress: Callable[[int], None],
) -> _Known | None:
    """What all robots of a generation learned, or None where it was stopped before the last."""
    n = len(robots.ids)
    known = _Known(np.zeros((n, run.config.iterations + 1)))
    for path in run.parts(search.generation):
        ids, losses, controllers = tables.read_outcome(path)
        index = ids - robots.ids[0]
        if not (index.min() >= 0 and index.max() < n and losses.shape[1] == known.losses.shape[1]):
            raise tables.damaged(path, "robots of this generation", InputError("others"))
        known.add(index, losses, controllers)
    progress(len(known.taught))
    size = teacher.robots_at_once(len(known.missing))
    for shard, outcome in teacher(_shards(search, robots, known.missing, size)):
        run.save_part(search.generation, robots.ids[shard.index], outcome.losses, outcome.controllers)
        known.add(shard.index, outcome.losses, outcome.controllers)
        progress(len(known.taught))
        if len(known.taught) < n and stopped():
            return None
    return known


def _shards(search: Search, robots: Robots, missing: IntArray, size: int) -> Iterator[Shard]:
    """Robots of about equal size together, the largest first: threads and machines end together."""
    config = search.config
    bodies = robots.morphologies(config.lattice)
    initial = search.initial_controllers(robots, bodies)
    largest_first = sorted(missing, key=lambda i: -len(bodies[i].springs))
    for k in range(0, len(largest_first), size):
        index = np.array(largest_first[k : k + size])
        yield Shard(
            index,
            tuple(bodies[i] for i in index),
            tuple(int(robots.seeds[i]) for i in index),
            config.scene,
            config.iterations,
            None if initial is None else tuple(initial[i] for i in index),
            config.training,
            config.randomisation,
        )
