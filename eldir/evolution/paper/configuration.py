"""The configuration of an evolution in the paper's scene, and its ground."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from eldir import defaults
from eldir.core import arguments
from eldir.core.records import Record, record
from eldir.defaults import CROSSOVERS, ITERATIONS, Crossover, EncodingName, Ground
from eldir.lattice import Lattice
from eldir.parameters.printed import BuiltParameters
from eldir.scene import TRAINING_FIELDS, Scene
from eldir.terrain import Terrain
from eldir.training.configuration import DERIVED, TrainingConfig
from eldir.training.randomisation import Randomisation

_MAX_MOTORS = 3  # motors in the second stage: 64 combinations of phases
_TILTS: dict[Ground, float] = {"level": 0.0, "incline": 0.2, "decline": -0.2}
"""Tilt of each kind of rugged ground, as `Terrain.rugged` takes it."""


@record
class EvolutionConfig(Record):
    """The configuration of a run: the same values give the same robots."""

    OPTIONAL = frozenset({"buildable", "second_stage", "inherit", "randomisation", "encoding"})
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
    encoding: EncodingName = defaults.ENCODING
    """What of a body is inherited: every triangle and spring, or a network that paints them."""
    crossover: Crossover = defaults.CROSSOVER
    """How two parents make a child: not at all, with bodies that differ, or with what they share; networks by
    their aligned genes."""
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
        possible = CROSSOVERS[self.encoding]
        expected = f"{', '.join(possible)} with the encoding {self.encoding}"
        arguments.require_value(
            "EvolutionConfig.crossover",
            self.crossover in possible,
            expected,
            self.crossover,
            "choose a crossover of the encoding",
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


def robot_seed(run_seed: int, generation: int, index: int) -> int:
    """The seed of one robot's initial weights; 63 bits. It does not depend on other robots."""
    sequence = np.random.SeedSequence(run_seed, spawn_key=(generation, index))
    return int(sequence.generate_state(1, np.uint64)[0] >> 1)


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
