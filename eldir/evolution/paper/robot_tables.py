"""Robots of the paper's scene as Parquet tables.

Weights are kept in the precision that they were trained in, row by row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.controller import HIDDEN, Controller
from eldir.core.kernels import Precision
from eldir.core.records import FloatArray, IntArray
from eldir.errors import InputError
from eldir.evolution import tables
from eldir.evolution.paper.encoding import Encoding
from eldir.evolution.paper.population import Robot
from eldir.genotype import stack, unstack
from eldir.lattice import Lattice

if TYPE_CHECKING:
    import pyarrow as pa

LAYERS = ("w1", "b1", "w2", "b2")
FLAGS = ("chaotic_updates", "rounded_updates")


def robots_columns(robots: Sequence[Robot], encoding: Encoding) -> dict[str, Any]:
    """Columns with identity and genotype of robots."""
    return {
        "id": np.array([r.number for r in robots], np.int64),
        "parent_1": np.array([r.parents[0] for r in robots], np.int64),
        "parent_2": np.array([r.parents[1] for r in robots], np.int64),
        "seed": np.array([r.seed for r in robots], np.int64),
        **tables.genotype_bits(*stack([r.genotype for r in robots])),
        **encoding.columns([r.genome for r in robots]),
    }


def outcome_columns(robots: Sequence[Robot], precision: Precision) -> dict[str, Any]:
    """Columns with losses, flags and learned weights of robots."""
    kind = np.float32 if precision == "f32" else np.float64
    columns = {"losses": tables.lists([r.losses for r in robots], np.float64), **flag_columns(robots)}
    learned = [r.controller for r in robots if r.controller]
    return columns | {k: tables.lists([getattr(c, k) for c in learned], kind) for k in LAYERS}


def flag_columns(robots: Sequence[Robot]) -> dict[str, Any]:
    """Columns with the number of updates of each robot whose gradient has a flag."""
    return {k: np.array([getattr(r, k) for r in robots], np.int32) for k in FLAGS}


def flags(table: pa.Table) -> list[IntArray]:
    """The inverse of `flag_columns`; -1 where an older version wrote the file."""
    return [
        np.asarray(table[k].to_numpy(), np.int32)
        if k in table.column_names
        else np.full(len(table), -1, np.int32)
        for k in FLAGS
    ]


def read_learned(path: Path, lattice: Lattice, encoding: Encoding) -> list[Robot]:
    """Robots with losses and weights, from a file that has both kinds of columns."""
    table = tables.read(path)
    try:
        has_walks = "walk" in table.column_names
        walks = np.array(table["walk"]) if has_walks else np.full(len(table), np.nan)
        parents = zip(table["parent_1"].to_pylist(), table["parent_2"].to_pylist(), strict=True)
        genotypes = unstack(*tables.genotype_columns(table, lattice))
        genomes = encoding.read(table)
        columns = (
            table["id"].to_pylist(), parents, table["seed"].to_pylist(),
            genotypes, *_outcome(table),
            [None if np.isnan(walk) else float(walk) for walk in walks],
            *(updates.tolist() for updates in flags(table)), genomes,
        )  # fmt: skip
        return [Robot(*values) for values in zip(*columns, strict=True)]
    except (KeyError, ValueError, IndexError, AttributeError, InputError) as error:
        raise tables.damaged(path, "the survivors of this run", error) from None


def read_part(path: Path, robots: Sequence[Robot], iterations: int) -> tuple[IntArray, list[Robot]]:
    """Indices of those of some robots that have learned, and what they have learned."""
    table = tables.read(path)
    try:
        index, (losses, controllers) = table["id"].to_numpy() - robots[0].number, _outcome(table)
        if not (index.min() >= 0 and index.max() < len(robots) and losses.shape[1] == iterations + 1):
            raise InputError("robots of another generation")
        columns = zip(index, losses, controllers, *(f.tolist() for f in flags(table)), strict=True)
        return index, [
            replace(robots[i], losses=own, controller=controller, chaotic_updates=c, rounded_updates=r)
            for i, own, controller, c, r in columns
        ]
    except (KeyError, ValueError, IndexError, AttributeError, InputError) as error:
        raise tables.damaged(path, "robots of this run that have learned", error) from None


def _outcome(table: pa.Table) -> tuple[FloatArray, tuple[Controller, ...]]:
    layers = zip(*(tables.rows(table, k) for k in LAYERS), strict=True)
    controllers = tuple(
        Controller(w1.reshape(HIDDEN, -1), b1, w2.reshape(-1, HIDDEN), b2) for w1, b1, w2, b2 in layers
    )
    return np.stack(tables.rows(table, "losses")), controllers
