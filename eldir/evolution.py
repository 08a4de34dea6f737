"""The genetic algorithm: bodies compete by how well they learn (paper, Sect. Genetic algorithm).

Ask and tell: `Search.ask` gives the robots of a generation, whoever calls has them learn, and
`Search.tell` selects. Generation 0 are the random progenitors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, get_args

import numpy as np

from eldir.built import build
from eldir.controller import Controller
from eldir.errors import EldirError, InputError
from eldir.frozen import BoolArray, FloatArray, IntArray, Record
from eldir.genotype import Genotype, random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.scene import Scene
from eldir.statics import static_margin
from eldir.variation import Crossover, offspring

Accept = Callable[[Morphology], bool]
"""Which bodies may be born, beside what the configuration asks; not kept in a run's folder."""
_ATTEMPTS = 200  # batches drawn for bodies that `accept` admits


@dataclass(frozen=True, eq=False)
class Evolution(Record):
    """What defines a run: the same values give the same robots."""

    lattice: Lattice = field(default_factory=Lattice)
    population: int = 64
    generations: int = 10
    """Generations of offspring that follow the random progenitors."""
    max_active: int | None = None
    """Most motors in a robot; two for building."""
    static_margin: float | None = None
    """Bodies whose centre of mass, when built, is not this far inside their feet are not born [m]."""
    crossover: Crossover = "none"
    iterations: int = 35
    """Updates while learning."""
    seed: int = 0
    scene: Scene = field(default_factory=Scene)

    def __post_init__(self) -> None:
        for name, least in (("population", 1), ("generations", 0), ("iterations", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InputError(f"Evolution.{name} is wrong", expected=f"at least {least}", found=str(value))
        if self.max_active is not None and self.max_active < 1:
            raise InputError(
                "Evolution.max_active is wrong", expected="at least 1", found=str(self.max_active)
            )
        if self.static_margin is not None and not np.isfinite(self.static_margin):
            raise InputError(
                "Evolution.static_margin is wrong", expected="metres", found=str(self.static_margin)
            )
        if self.crossover not in get_args(Crossover):
            raise InputError(
                "Evolution.crossover is wrong",
                expected=" | ".join(get_args(Crossover)),
                found=repr(self.crossover),
            )

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of `from_json`."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        values["lattice"] = {"rows": self.lattice.rows, "columns": self.lattice.columns}
        values["scene"] = self.scene.to_json()
        return values

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Evolution:
        """From `to_json`."""
        built = {"lattice": Lattice(**values["lattice"]), "scene": Scene.from_json(values["scene"])}
        return cls(**(values | built))


@dataclass(frozen=True, eq=False)
class Robots(Record):
    """N robots before learning."""

    genotypes: tuple[Genotype, ...]
    ids: IntArray
    """generation * population + index, unique in a run, shape (N,)."""
    parents: IntArray
    """Ids of both progenitors, shape (N, 2): equal where there was one, -1 where there was none."""
    seeds: IntArray
    """Of each robot's initial weights, shape (N,)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "genotypes", tuple(self.genotypes))
        n = len(self.genotypes)
        self._set_array("ids", np.int64, (n,))
        self._set_array("parents", np.int64, (n, 2))
        self._set_array("seeds", np.int64, (n,))

    def morphologies(self, lattice: Lattice) -> list[Morphology]:
        """The developed bodies."""
        return [develop(lattice, g) for g in self.genotypes]


@dataclass(frozen=True, eq=False)
class Learned(Record):
    """N robots after learning."""

    robots: Robots
    losses: FloatArray
    """Before the first update and after each [m], shape (N, iterations + 1)."""
    controllers: tuple[Controller, ...]
    """The best of each robot."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "controllers", tuple(self.controllers))
        self._set_array("losses", np.float64, (len(self.robots.genotypes), None))
        if len(self.controllers) != len(self.losses):
            raise InputError(
                "controllers and losses do not match",
                expected=f"{len(self.losses)} controllers",
                found=str(len(self.controllers)),
            )

    def fitness(self) -> FloatArray:
        """Greatest net displacement over all iterations [m], shape (N,)."""
        return -self.losses.min(axis=1)

    def take(self, index: IntArray) -> Learned:
        """Some of the robots, in the given order."""
        r = self.robots
        chosen = Robots(tuple(r.genotypes[i] for i in index), r.ids[index], r.parents[index], r.seeds[index])
        return Learned(chosen, self.losses[index], tuple(self.controllers[i] for i in index))

    def joined(self, other: Learned) -> Learned:
        """These robots, then the others."""
        a, b = self.robots, other.robots
        robots = Robots(
            a.genotypes + b.genotypes,
            *(np.concatenate([getattr(a, k), getattr(b, k)]) for k in ("ids", "parents", "seeds")),
        )
        return Learned(
            robots, np.concatenate([self.losses, other.losses]), self.controllers + other.controllers
        )


class LearningOutcome(Protocol):
    """What `Search.tell` wants to know; `eldir.learning.LearningResult` is one."""

    @property
    def losses(self) -> FloatArray:
        """Shape (N, iterations + 1) [m]."""

    @property
    def controllers(self) -> Sequence[Controller]:
        """The best of each robot."""


def valid(losses: FloatArray, jump_threshold: float) -> BoolArray:
    """Which robots count, shape (N,): every loss finite and no jump between two iterations above
    the threshold [m]. The only place where a result is thrown away."""
    with np.errstate(invalid="ignore"):
        jumps = np.abs(np.diff(losses, axis=1)).max(axis=1, initial=0.0)
        return np.isfinite(losses).all(axis=1) & (jumps <= jump_threshold)


def select(pool: Learned, n: int, jump_threshold: float) -> Learned:
    """The best `n` of the valid robots, best first; of equal ones, the elder."""
    sound = pool.take(np.flatnonzero(valid(pool.losses, jump_threshold)))
    return sound.take(np.argsort(-sound.fitness(), kind="stable")[:n])


class Search:
    """The state of a run: the survivors of the generations told so far."""

    def __init__(
        self,
        config: Evolution,
        accept: Accept | None = None,
        generation: int = 0,
        survivors: Learned | None = None,
    ):
        self.config = config
        self.generation = generation
        """The one that `ask` gives next."""
        self.survivors = survivors
        """Best first; None before generation 0 was told."""
        self._accept = accept

    @property
    def finished(self) -> bool:
        """Whether every generation was told."""
        return self.generation > self.config.generations

    def ask(self) -> Robots:
        """The robots of this generation; asking again gives the same ones."""
        c = self.config
        rng = np.random.default_rng(_seed_sequence(c.seed, self.generation))
        genotypes, parents = self._progenitors(rng) if self.survivors is None else self._offspring(rng)
        index = np.arange(len(genotypes))
        seeds = np.array([robot_seed(c.seed, self.generation, int(i)) for i in index], np.int64)
        return Robots(tuple(genotypes), self.generation * c.population + index, parents, seeds)

    def tell(self, robots: Robots, outcome: LearningOutcome) -> Learned:
        """Select among parents and offspring; parents keep the losses they have."""
        learned = Learned(robots, outcome.losses, tuple(outcome.controllers))
        pool = learned if self.survivors is None else self.survivors.joined(learned)
        survivors = select(pool, self.config.population, self.config.scene.jump_threshold)
        if not len(survivors.losses):
            raise EldirError(
                "no robot of the first generation was stable",
                expected="at least one whose losses are finite and steady",
                remedy="use a larger population, another seed or a smaller step",
            )
        self.survivors = survivors
        self.generation += 1
        return learned

    def _progenitors(self, rng: np.random.Generator) -> tuple[list[Genotype], IntArray]:
        c = self.config
        found: list[Genotype] = []
        for _ in range(_ATTEMPTS):
            drawn = random_genotypes(c.lattice, c.population - len(found), rng, c.max_active)
            found += [g for g in drawn if self._accepted(g)]
            if len(found) == c.population:
                return found, np.full((c.population, 2), -1)
        raise _nothing_accepted(c.population - len(found))

    def _offspring(self, rng: np.random.Generator) -> tuple[list[Genotype], IntArray]:
        c = self.config
        assert self.survivors is not None
        progenitors = self.survivors.robots
        found: list[Genotype | None] = [None] * len(progenitors.genotypes)
        parents = np.zeros((len(found), 2), np.int64)
        for _ in range(_ATTEMPTS):
            drawn, of = offspring(c.lattice, list(progenitors.genotypes), rng, c.crossover, c.max_active)
            for i in [i for i, g in enumerate(found) if g is None]:
                if self._accepted(drawn[i]):
                    found[i], parents[i] = drawn[i], progenitors.ids[of[i]]
            whole = [g for g in found if g is not None]
            if len(whole) == len(found):
                return whole, parents
        raise _nothing_accepted(len(found) - len(whole))

    def _accepted(self, genotype: Genotype) -> bool:
        least = self.config.static_margin
        if least is None and self._accept is None:
            return True
        body = develop(self.config.lattice, genotype)
        stands = least is None or static_margin(build(body)) >= least
        return stands and (self._accept is None or bool(self._accept(body)))


def robot_seed(run_seed: int, generation: int, index: int) -> int:
    """The seed of one robot's initial weights, whatever else is in its generation; 63 bits."""
    return int(_seed_sequence(run_seed, generation, index).generate_state(1, np.uint64)[0] >> 1)


def _seed_sequence(run_seed: int, *key: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(run_seed, spawn_key=key)


def _nothing_accepted(missing: int) -> EldirError:
    return EldirError(
        "too few bodies are accepted",
        expected=f"one accepted body for every place within {_ATTEMPTS} attempts",
        found=f"{missing} places still empty",
        remedy="relax the condition or enlarge the lattice",
    )
