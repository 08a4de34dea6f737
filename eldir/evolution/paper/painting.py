"""The encoding by a pattern-producing network, which paints triangles, motors and phases by their places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.controller import CPGS, Controller
from eldir.core.records import FloatArray, IntArray
from eldir.defaults import Crossover
from eldir.evolution import tables
from eldir.evolution.paper.cppn import Cppn
from eldir.evolution.paper.cppn_variation import cross, mutate, random_network
from eldir.evolution.variation import CROSSOVER_SHARE, draw_pairs
from eldir.genotype import Genotype, repair_bodies
from eldir.lattice import Lattice
from eldir.morphology import Morphology

if TYPE_CHECKING:
    import pyarrow as pa

_MUTATIONS = 20  # of one offspring until its body differs; each is twice as strong as the one before
_MAX_STRENGTH = 8.0
_COLUMNS = {"functions": np.int64, "links": np.int64, "weights": np.float64, "enabled": np.int8}


@dataclass(frozen=True)
class CppnEncoding:
    """Genomes are networks: their size does not depend on the size of the lattice."""

    lattice: Lattice
    crossover: Crossover = "none"
    max_active: int | None = None
    has_initial_weights = True

    def random(self, n: int, rng: np.random.Generator) -> list[Cppn]:
        return [random_network(rng) for _ in range(n)]

    def make_offspring(
        self, progenitors: Sequence[Cppn], rng: np.random.Generator
    ) -> tuple[list[Cppn], IntArray]:
        n = len(progenitors)
        parents = np.repeat(np.arange(n, dtype=np.int32)[:, None], 2, axis=1)
        networks = list(progenitors)
        if self.crossover != "none" and n > 1:
            crossed = np.flatnonzero(rng.random(n) < CROSSOVER_SHARE)
            parents[crossed] = draw_pairs(n, len(crossed), rng)
            for i in crossed:
                fitter, other = sorted(parents[i])
                networks[i] = cross(progenitors[fitter], progenitors[other], rng)
        return [self._mutate(network, rng) for network in networks], parents

    def _mutate(self, network: Cppn, rng: np.random.Generator) -> Cppn:
        """Mutated until the body differs, as in the direct encoding; at last as it is, because a lattice may
        have no other body."""
        (before,) = self.develop([network])
        for k in range(_MUTATIONS):
            child = mutate(network, rng, min(2.0**k, _MAX_STRENGTH))
            if not np.array_equal(self.develop([child])[0].triangles, before.triangles):
                break
        return child

    def develop(self, genomes: Sequence[Cppn]) -> list[Genotype]:
        """Triangles are filled where "fill" is above 0, and where it is greatest; springs act where "motor"
        is. Bodies are repaired as those of the direct encoding. Of too many motors those with the greatest
        values stay; without any, the spring with the greatest value acts."""
        painted = [genome.paint(self._places) for genome in genomes]
        cells = self.lattice.rows * self.lattice.columns
        fill = np.stack([values[:cells, 0] for values in painted])
        filled = (fill > 0) | (np.arange(cells) == fill.argmax(axis=1)[:, None])
        triangles = repair_bodies(self.lattice, filled.reshape(-1, self.lattice.rows, self.lattice.columns))
        expressed = self.lattice.expressed_springs(triangles)
        return [
            Genotype(body, self._choose_motors(values[cells:, 1], own))
            for body, values, own in zip(triangles, painted, expressed, strict=True)
        ]

    def _choose_motors(self, value: FloatArray, expressed: Any) -> Any:
        ranked = np.flatnonzero(expressed)
        ranked = ranked[np.argsort(-value[ranked], kind="stable")]
        count = max(1, int((value[ranked] > 0).sum()))
        chosen = np.zeros(len(value), bool)
        chosen[ranked[: count if self.max_active is None else min(count, self.max_active)]] = True
        return chosen

    def initial_controller(self, genome: Cppn, body: Morphology, fresh: Controller) -> Controller:
        """Random weights, with those of the motors such that each motor begins as a wave with about its
        painted phase, by its hidden neurons' linear response to the pattern generators; as long as the random
        ones."""
        places = self._places[self.lattice.rows * self.lattice.columns :]
        phase = np.pi * genome.paint(places[body.lattice_springs[body.active]])[:, 2]
        response = fresh.w1[:, :CPGS] @ np.exp(2j * np.pi / CPGS * np.arange(CPGS))
        w2 = np.abs(response) * np.cos(np.angle(response) - phase[:, None])
        w2 *= np.linalg.norm(fresh.w2, axis=1, keepdims=True) / np.linalg.norm(w2, axis=1, keepdims=True)
        return Controller(fresh.w1, fresh.b1, w2, fresh.b2)

    @cached_property
    def _places(self) -> FloatArray:
        """Middles of all triangles, then of all springs, from -1 to 1 along the longer side."""
        vertices = self.lattice.vertices * [1.0, np.sqrt(3.0)]
        parts = [vertices[corners].mean(axis=1) for corners in (self.lattice.triangles, self.lattice.springs)]
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        places: FloatArray = (np.concatenate(parts) - (low + high) / 2) / ((high - low).max() / 2)
        return places

    def columns(self, genomes: Sequence[Cppn]) -> dict[str, Any]:
        kinds = {"nodes": np.int64, **_COLUMNS}
        return {
            f"cppn_{k}": tables.lists([getattr(g, k) for g in genomes], kind) for k, kind in kinds.items()
        }

    def read(self, table: pa.Table) -> list[Cppn]:
        columns = [tables.rows(table, f"cppn_{k}") for k in ("nodes", *_COLUMNS)]
        return [
            Cppn(nodes, functions, links.reshape(-1, 2), weights, enabled.astype(bool))
            for nodes, functions, links, weights, enabled in zip(*columns, strict=True)
        ]
