"""Encodings: what of a robot varies and is inherited, and how a body follows from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from eldir.controller import Controller
from eldir.core.records import IntArray
from eldir.defaults import Crossover
from eldir.evolution.paper.painting import CppnEncoding
from eldir.evolution.variation import make_offspring
from eldir.genotype import Genotype, random_genotypes
from eldir.morphology import Morphology

if TYPE_CHECKING:
    import pyarrow as pa

    from eldir.evolution.paper.configuration import EvolutionConfig
    from eldir.lattice import Lattice


class Encoding(Protocol):
    """Genomes of one kind, which are values without a state outside, and the bodies that they describe."""

    @property
    def has_initial_weights(self) -> bool:
        """Whether genomes describe initial weights too."""

    def random(self, n: int, rng: np.random.Generator) -> list[Any]:
        """Random genomes."""

    def make_offspring(
        self, progenitors: Sequence[Any], rng: np.random.Generator
    ) -> tuple[list[Any], IntArray]:
        """One varied genome for every progenitor, of which the best is the first, and the indices of both
        parents, shape (N, 2); they are equal where there was one."""

    def develop(self, genomes: Sequence[Any]) -> list[Genotype]:
        """The bodies on the lattice, repaired: in one piece, with at least one motor."""

    def initial_controller(self, genome: Any, body: Morphology, fresh: Controller) -> Controller:
        """The initial weights of a genome, from random ones."""

    def columns(self, genomes: Sequence[Any]) -> dict[str, Any]:
        """Columns of a table with what `develop` needs."""

    def read(self, table: pa.Table) -> list[Any]:
        """The inverse of `columns`; None where the genotype is the genome."""


@dataclass(frozen=True)
class DirectEncoding:
    """Genomes are the bodies themselves: a bit for every triangle and for every spring."""

    lattice: Lattice
    crossover: Crossover = "none"
    max_active: int | None = None
    has_initial_weights = False

    def random(self, n: int, rng: np.random.Generator) -> list[Genotype]:
        return random_genotypes(self.lattice, n, rng, self.max_active)

    def make_offspring(
        self, progenitors: Sequence[Genotype], rng: np.random.Generator
    ) -> tuple[list[Genotype], IntArray]:
        return make_offspring(self.lattice, list(progenitors), rng, self.crossover, self.max_active)

    def develop(self, genomes: Sequence[Genotype]) -> list[Genotype]:
        return list(genomes)

    def initial_controller(self, genome: Genotype, body: Morphology, fresh: Controller) -> Controller:
        return fresh

    def columns(self, genomes: Sequence[Genotype]) -> dict[str, Any]:
        """None: every table of robots has their bodies."""
        return {}

    def read(self, table: pa.Table) -> list[None]:
        return [None] * len(table)


def make_encoding(config: EvolutionConfig) -> Encoding:
    """The encoding of a run."""
    if config.encoding == "cppn":
        return CppnEncoding(config.lattice, config.crossover, config.max_active)
    return DirectEncoding(config.lattice, config.crossover, config.max_active)
