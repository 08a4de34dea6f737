"""Extreme bodies, grounds and states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eldir.core.records import BoolArray
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.scene import Scene
from eldir.terrain import Terrain

SHAPES: dict[str, list[tuple[int, int]]] = {
    "triangle": [(0, 1)],
    "hinge": [(0, 1), (1, 1)],
    "beam": [(0, column) for column in range(22)],
    "tower": [(row, 5) for row in range(13)],
    "lattice": [(row, column) for row in range(13) for column in range(22)],
}


def bodies() -> dict[str, Morphology]:
    """One triangle, two on a hinge, a 22-long beam, a tower, the whole lattice; none and all active;
    two masses in one place; springs that expand at once without limit; a body half in the ground."""
    found = {name: body_of(cells) for name, cells in SHAPES.items()}
    few = body_of([(0, 1), (0, 2), (0, 3), (1, 3)])
    found["no active spring"] = replace(few, active=np.zeros(len(few.springs), bool))
    found["all active"] = replace(few, active=np.ones(len(few.springs), bool))
    merged = few.positions.copy()
    merged[1] = merged[0]
    found["coincident masses"] = replace(few, positions=merged)
    found["bursting"] = replace(found["hinge"], rest_lengths=np.full(len(found["hinge"].springs), 1e30))
    found["in the ground"] = replace(few, positions=few.positions - np.array([0, 0.09]))
    return found


def body_of(cells: list[tuple[int, int]]) -> Morphology:
    """Triangles by row and column on the paper's lattice, half of the springs active."""
    lattice, mask = Lattice(), np.zeros((13, 22), bool)
    mask[tuple(np.array(cells).T)] = True
    return develop(lattice, Genotype(mask, _half(lattice, mask)))


def _half(lattice: Lattice, mask: BoolArray) -> BoolArray:
    active = np.random.default_rng(0).random(len(lattice.springs)) < 0.5
    active[np.flatnonzero(lattice.expressed_springs(mask))[0]] = True
    return active


def grounds(scene: Scene) -> dict[str, Scene]:
    """Flat with and without slip, rugged, a slope of 72 degrees, and one ridge."""
    steep = Terrain.from_segments(np.array([-1.0, 0.1]), np.array([0.0, 3.0]), np.array([0.1, -0.2]))
    ridge = Terrain.from_segments(np.array([-1.0, 0.05]), np.array([0.5, -0.5]), np.array([0.075, 0.125]))
    return {
        "no slip": scene,
        "friction": scene.replace(contact="friction"),
        "rugged": scene.replace(terrain=Terrain.rugged(np.random.default_rng(1))),
        "steep": scene.replace(terrain=steep),
        "ridge": scene.replace(terrain=ridge),
    }
