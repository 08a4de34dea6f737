"""From an evolved robot in simulation to the same robot walking on a table.

The names below are the public interface (docs/reference/python.md); each is imported when it is first used.
"""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

from eldir.core.version import __version__ as __version__

if TYPE_CHECKING:
    from eldir.controller import Controller as Controller
    from eldir.design import Design as Design
    from eldir.evolution.loop import evolve as evolve
    from eldir.evolution.search import Evolution as Evolution
    from eldir.genotype import Genotype as Genotype
    from eldir.genotype import random_genotypes as random_genotypes
    from eldir.lattice import Lattice as Lattice
    from eldir.learning import learn as learn
    from eldir.marks import marked_masses as marked_masses
    from eldir.morphology import Morphology as Morphology
    from eldir.morphology import develop as develop
    from eldir.rollout import loss_and_gradient as loss_and_gradient
    from eldir.rollout import simulate as simulate
    from eldir.scene import Scene as Scene
    from eldir.terrain import Terrain as Terrain
    from eldir.trajectory import Trajectory as Trajectory

logging.getLogger(__name__).addHandler(logging.NullHandler())  # programs decide what is written

__all__ = [
    "Controller",
    "Design",
    "Evolution",
    "Genotype",
    "Lattice",
    "Morphology",
    "Scene",
    "Terrain",
    "Trajectory",
    "built",
    "develop",
    "evolve",
    "learn",
    "loss_and_gradient",
    "marked_masses",
    "random_genotypes",
    "simulate",
]

# Where each name is imported from, when it is first used.
_HOMES = {
    "Controller": "eldir.controller",
    "Design": "eldir.design",
    "Evolution": "eldir.evolution.search",
    "Genotype": "eldir.genotype",
    "Lattice": "eldir.lattice",
    "Morphology": "eldir.morphology",
    "Scene": "eldir.scene",
    "Terrain": "eldir.terrain",
    "Trajectory": "eldir.trajectory",
    "develop": "eldir.morphology",
    "evolve": "eldir.evolution.loop",
    "learn": "eldir.learning",
    "loss_and_gradient": "eldir.rollout",
    "marked_masses": "eldir.marks",
    "random_genotypes": "eldir.genotype",
    "simulate": "eldir.rollout",
}


def __getattr__(name: str) -> Any:
    if name == "built":
        return import_module("eldir.built")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), "built", *_HOMES})
