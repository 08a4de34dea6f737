"""The genetic algorithm: bodies compete by how well they learn (paper, Sect. Genetic algorithm).

Ask and tell: `Search.ask` gives the robots of a generation, the caller trains them, and `Search.tell`
selects. Generation 0 consists of random progenitors. `make_scene` gives their ground.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from functools import partial
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from eldir import defaults
from eldir.built.robot import build, find_shape_fault, static_margin
from eldir.built.screening import simulate_soft_walks
from eldir.controller import Controller
from eldir.core import arguments
from eldir.core.records import FloatArray, IntArray, Record, record
from eldir.defaults import ITERATIONS, Crossover, Ground
from eldir.errors import EldirError
from eldir.evolution.population import LearnedRobots, LearningOutcome, Robots, select
from eldir.evolution.variation import inherit, make_offspring
from eldir.genotype import Genotype, random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.parameters.printed import BuiltParameters
from eldir.scene import TRAINING_FIELDS, Scene
from eldir.terrain import Terrain
from eldir.training.configuration import DERIVED, TrainingConfig
from eldir.training.loop import initial_controllers
from eldir.training.randomisation import Randomisation

AcceptBody = Callable[[Morphology], bool]
"""A further condition on new bodies, in addition to the configuration. The run folder does not contain it."""
WalkFunction = Callable[[Sequence[Morphology]], FloatArray]
"""A function that gives the walk of printed bodies, for the second stage."""
_ATTEMPTS = 200  # batches sampled for bodies that are accepted
_MAX_MOTORS = 3  # motors in the second stage: 64 combinations of phases
_TILTS: dict[Ground, float] = {"level": 0.0, "incline": 0.2, "decline": -0.2}
"""Tilt of each kind of rugged ground, as `Terrain.rugged` takes it."""


@record
class EvolutionConfig(Record):
    """The configuration of a run: the same values give the same robots."""

    OPTIONAL = frozenset({"buildable", "second_stage", "inherit", "randomisation"})
    """What older runs lack."""

    lattice: Lattice = field(default_factory=lambda: Lattice(*defaults.LATTICE))
    """Size of the lattice in which bodies lie."""
    population: Annotated[int, Field(ge=1, le=defaults.MAX_POPULATION)] = defaults.POPULATION
    """Number of robots of a generation."""
    generations: Annotated[int, Field(ge=0, le=defaults.MAX_GENERATIONS)] = defaults.GENERATIONS
    """Generations of offspring that follow the random progenitors."""
    max_active: Annotated[int, Field(ge=1)] | None = None
    """Largest number of motors in a robot; two for building."""
    static_margin: float | None = None
    """Least distance of the centre of mass from the edge of the feet, when built [m]; other bodies are
    rejected."""
    buildable: bool = False
    """Bodies must be rigid with all springs, and their motors must be able to deform them, when built."""
    second_stage: bool = False
    """Survivors are simulated as built, and those that fall over or fold are removed."""
    crossover: Crossover = defaults.CROSSOVER
    """How two parents make a child: not at all, with bodies that differ, or with what they share."""
    inherit: bool = False
    """Offspring of one parent start from its learned weights."""
    iterations: Annotated[int, Field(ge=1, le=defaults.MAX_ITERATIONS)] = ITERATIONS
    """Updates of every robot."""
    randomisation: Randomisation | None = None
    """The distribution from which physics are sampled while robots learn. None: the scene's physics."""
    seed: Annotated[int, Field(ge=0)] = defaults.SEED
    """Seed of the run's random numbers."""
    scene: Scene = field(default_factory=Scene)
    """The simulation in which robots learn."""
    training: TrainingConfig = DERIVED
    """Configuration of learning, and of which robots count as stable. Default: `TrainingConfig.of(scene)`."""

    def __post_init__(self) -> None:
        if self.training is None:
            object.__setattr__(self, "training", TrainingConfig.of(self.scene))
        arguments.require_memory(self.lattice.rows, self.lattice.columns, self.population, self.iterations)
        if self.static_margin is not None:
            arguments.require_margin(
                "EvolutionConfig.static_margin",
                self.static_margin,
                self.lattice.columns,
                BuiltParameters().pitch,
            )
        few = not self.second_stage or (self.max_active is not None and self.max_active <= _MAX_MOTORS)
        expected = f"at most {_MAX_MOTORS}, as EvolutionConfig.second_stage tries all phases of the motors"
        remedy = "limit the motors: --max-motors 2"
        arguments.require_value("EvolutionConfig.max_active", few, expected, self.max_active, remedy)

    @classmethod
    def upgrade(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Older runs hold the training in the scene, and the randomisation as "doubt" or not at all."""
        values = dict(values)
        if drawn := values.pop("doubt", None):
            values["randomisation"] = drawn
        if "training" not in values:
            scene = values["scene"]
            values["training"] = {name: scene[name] for name in TRAINING_FIELDS if name in scene}
        return values


class Search:
    """The state of a run: the survivors after the last complete generation."""

    def __init__(
        self,
        config: EvolutionConfig,
        accept: AcceptBody | None = None,
        generation: int = 0,
        survivors: LearnedRobots | None = None,
        walks: WalkFunction | None = None,
    ):
        self.config = config
        self.generation = generation
        """Number of the generation that `ask` gives next."""
        self.survivors = survivors
        """Survivors, best first; None before generation 0 is complete."""
        self._accept = accept
        self._walks = walks or partial(simulate_soft_walks, terrain=printed_terrain(config.scene))

    @property
    def finished(self) -> bool:
        """Whether the last generation is complete."""
        return self.generation > self.config.generations

    def ask(self) -> Robots:
        """The robots of this generation; asking again gives the same ones."""
        c = self.config
        rng = np.random.default_rng(np.random.SeedSequence(c.seed, spawn_key=(self.generation,)))
        genotypes, parents = self._progenitors(rng) if self.survivors is None else self._offspring(rng)
        index = np.arange(len(genotypes))
        seeds = np.array([robot_seed(c.seed, self.generation, i) for i in index.tolist()], np.int64)
        return Robots(tuple(genotypes), self.generation * c.population + index, parents, seeds)

    def tell(self, robots: Robots, outcome: LearningOutcome) -> LearnedRobots:
        """Select among parents and offspring; parents keep their losses. Raises `EldirError` where no robot
        of the first generation is stable."""
        learned = LearnedRobots(
            robots, outcome.losses, tuple(outcome.controllers),
            chaotic_updates=outcome.chaotic_updates, rounded_updates=outcome.rounded_updates,
        )  # fmt: skip
        if self.config.second_stage:
            learned = self._walk_survivors(learned)
        survivors = self._select_survivors(learned)
        if not len(survivors.losses):
            raise EldirError(
                "no robot of the first generation was stable",
                code="evolution.none-stable",
                expected="at least one whose losses are finite and steady",
                remedy="use a larger population, another seed or a smaller step",
            )
        self.survivors = survivors
        self.generation += 1
        return learned

    def initial_controllers(self, robots: Robots, bodies: Sequence[Morphology]) -> list[Controller] | None:
        """The initial weights of this generation if weights are inherited. None: random weights."""
        if not self.config.inherit or self.survivors is None:
            return None
        fresh = initial_controllers(bodies, self.config.scene, robots.seeds.tolist())
        progenitors = self.survivors.robots
        place = {number: i for i, number in enumerate(progenitors.ids.tolist())}
        for i, (one, other) in enumerate(robots.parents.tolist()):
            if one == other:  # masks of two are shifted against each other: their places no longer agree
                parent = develop(self.config.lattice, progenitors.genotypes[place[one]])
                fresh[i] = inherit(parent, self.survivors.controllers[place[one]], bodies[i], fresh[i])
        return fresh

    def _select_survivors(self, learned: LearnedRobots) -> LearnedRobots:
        pool = learned if self.survivors is None else self.survivors.join(learned)
        return select(pool, self.config.population, self.config.training.jump_threshold)

    def _walk_survivors(self, learned: LearnedRobots) -> LearnedRobots:
        """The same robots, with the walks as built of all that would survive, including those that replace
        fallen ones."""
        while True:
            unknown = np.isin(learned.robots.ids, self._select_survivors(learned).robots.ids) & np.isnan(
                learned.walks
            )
            if not unknown.any():
                return learned
            bodies = learned.take(np.flatnonzero(unknown)).robots.morphologies(self.config.lattice)
            walks = learned.walks.copy()
            walks[unknown] = self._walks(bodies)
            learned = replace(learned, walks=walks)

    def _progenitors(self, rng: np.random.Generator) -> tuple[list[Genotype], IntArray]:
        c = self.config
        found: list[Genotype] = []
        for _ in range(_ATTEMPTS):
            drawn = random_genotypes(c.lattice, c.population - len(found), rng, c.max_active)
            found += [g for g in drawn if self._is_accepted(g)]
            if len(found) == c.population:
                return found, np.full((c.population, 2), -1)
        raise _too_few_bodies_error(c.population - len(found))

    def _offspring(self, rng: np.random.Generator) -> tuple[list[Genotype], IntArray]:
        c = self.config
        assert self.survivors is not None
        progenitors = self.survivors.robots
        found: list[Genotype | None] = [None] * len(progenitors.genotypes)
        parents = np.zeros((len(found), 2), np.int64)
        for _ in range(_ATTEMPTS):
            drawn, of = make_offspring(c.lattice, list(progenitors.genotypes), rng, c.crossover, c.max_active)
            for i in [i for i, g in enumerate(found) if g is None]:
                if self._is_accepted(drawn[i]):
                    found[i], parents[i] = drawn[i], progenitors.ids[of[i]]
            whole = [g for g in found if g is not None]
            if len(whole) == len(found):
                return whole, parents
        raise _too_few_bodies_error(len(found) - len(whole))

    def _is_accepted(self, genotype: Genotype) -> bool:
        c = self.config
        if c.static_margin is None and not c.buildable and self._accept is None:
            return True
        body = develop(c.lattice, genotype)
        if c.static_margin is not None and static_margin(build(body)) < c.static_margin:
            return False
        if c.buildable and find_shape_fault(build(body)):
            return False
        return self._accept is None or bool(self._accept(body))


def robot_seed(run_seed: int, generation: int, index: int) -> int:
    """The seed of one robot's initial weights; 63 bits. It does not depend on other robots."""
    sequence = np.random.SeedSequence(run_seed, spawn_key=(generation, index))
    return int(sequence.generate_state(1, np.uint64)[0] >> 1)


def _too_few_bodies_error(missing: int) -> EldirError:
    return EldirError(
        "too few bodies are accepted",
        code="evolution.too-few-bodies",
        expected=f"one accepted body for every place within {_ATTEMPTS} attempts",
        found=f"{missing} places still empty",
        remedy="relax the condition or enlarge the lattice",
    )


def make_scene(ground: Ground, seed: int) -> Scene:
    """The paper's scene on this ground."""
    scene = Scene.preset("paper")
    return scene if ground == "flat" else scene.replace(terrain=make_terrain(ground, seed))


def printed_terrain(scene: Scene) -> Terrain | None:
    """The ground of a scene under the printed robots of its run [m, of the printed robot]; None: a table."""
    return None if scene.terrain.is_flat else scene.terrain.scaled(BuiltParameters().scale)


def make_terrain(ground: Ground, seed: int) -> Terrain:
    """Flat ground, or rugged ground with one of three tilts (paper, Sect. Terrain), drawn from the seed of
    the run."""
    if ground == "flat":
        return Terrain.flat()
    # A key of its own: the robots' seeds have keys of two numbers, the generations' of one.
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 0, 0)))
    return Terrain.rugged(rng, _TILTS[ground])
