"""The trial of the paper's robots: they learn, in shards that are saved when they are done."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from eldir.controller import Controller
from eldir.core.records import IntArray
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.encoding import make_encoding
from eldir.evolution.paper.population import Robot
from eldir.evolution.variation import inherit
from eldir.learning import LearningResult, learn
from eldir.morphology import Morphology, develop, develop_all
from eldir.training.loop import initial_controllers


@dataclass(frozen=True)
class Shard:
    """Some robots of a generation."""

    index: IntArray
    """Indices of the robots in the generation, shape (n,)."""
    robots: Sequence[Robot]
    bodies: Sequence[Morphology]
    controllers: Sequence[Controller] | None
    """Initial weights. None: random weights from the seeds."""
    config: EvolutionConfig

    @property
    def seeds(self) -> list[int]:
        """Seed of each robot's initial weights."""
        return [r.seed for r in self.robots]

    def run(self) -> list[Robot]:
        """Train these robots in this process."""
        c = self.config
        outcome = learn(
            self.bodies, c.scene, c.iterations, self.seeds, self.controllers,
            training=c.training, randomisation=c.randomisation,
        )  # fmt: skip
        return add_outcome(self.robots, outcome)


def add_outcome(robots: Sequence[Robot], outcome: LearningResult) -> list[Robot]:
    """The robots with what they have learned."""
    learned = zip(
        outcome.losses, outcome.controllers, outcome.chaotic_updates, outcome.rounded_updates, strict=True
    )
    return [
        replace(robot, losses=losses, controller=controller, chaotic_updates=int(c), rounded_updates=int(r))
        for robot, (losses, controller, c, r) in zip(robots, learned, strict=True)
    ]


@dataclass(frozen=True)
class LearningBatch:
    """All robots of a generation, which have to learn."""

    robots: Sequence[Robot]
    config: EvolutionConfig
    progenitors: Mapping[int, Robot] = field(default_factory=dict)
    """By id, where weights are inherited."""
    span = (0.0, 1.0)
    has_long_tasks = True

    def __len__(self) -> int:
        return len(self.robots)

    @cached_property
    def bodies(self) -> list[Morphology]:
        """The developed bodies."""
        return develop_all(self.config.lattice, [r.genotype for r in self.robots])

    @property
    def seeds(self) -> list[int]:
        """Seed of each robot's initial weights."""
        return [r.seed for r in self.robots]

    def parts(self, index: IntArray, size: int) -> Iterator[Shard]:
        """Robots of about equal size together, the largest first, so that threads and machines end
        together."""
        config = self.config
        springs = config.lattice.expressed_springs(np.stack([r.genotype.triangles for r in self.robots]))
        largest_first = index[np.argsort(-springs.sum(axis=1)[index], kind="stable")]
        for k in range(0, len(index), size):
            own = largest_first[k : k + size]
            some = LearningBatch([self.robots[i] for i in own], config, self.progenitors)
            yield Shard(own, some.robots, some.bodies, some.initial_controllers(), config)

    def initial_controllers(self) -> list[Controller] | None:
        """The initial weights if the genomes describe them, or if they are inherited. None: random
        weights."""
        encoding = make_encoding(self.config)
        if not (self.progenitors or encoding.has_initial_weights):
            return None
        fresh = initial_controllers(self.bodies, self.config.scene, self.seeds)
        for i, robot in enumerate(self.robots):
            if encoding.has_initial_weights:
                fresh[i] = encoding.initial_controller(robot.genome, self.bodies[i], fresh[i])
            if not self.progenitors:
                continue
            one, other = robot.parents
            parent = self.progenitors[one]
            if one == other and parent.controller:  # masks of two are shifted: their places do not agree
                body = develop(self.config.lattice, parent.genotype)
                fresh[i] = inherit(body, parent.controller, self.bodies[i], fresh[i])
        return fresh

    def join(self, found: Sequence[tuple[IntArray, Sequence[Robot]]]) -> list[Robot]:
        """All robots, in their order."""
        learned = {robot.number: robot for _, robots in found for robot in robots}
        return [learned[robot.number] for robot in self.robots]
