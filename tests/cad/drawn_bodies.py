"""Hand-made bodies for the tests of cad: small masks drawn as a person sees them, top row first."""

import numpy as np

from eldir.controller import Controller
from eldir.design import Design
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.scene import Scene


def body(*rows: str, motors: tuple[int, ...] = (0,)) -> Morphology:
    """A morphology from rows of 0 and 1, the `motors` counted among its springs."""
    lattice, genotype = drawn(rows, motors)
    return develop(lattice, genotype)


def design(*rows: str, motors: tuple[int, ...] = (0,)) -> Design:
    """A design of that body with a seeded controller."""
    lattice, genotype = drawn(rows, motors)
    masses = len(develop(lattice, genotype).positions)
    controller = Controller.random(masses, len(motors), np.random.default_rng(0))
    return Design(lattice, genotype, controller, Scene.preset("paper"), provenance={"id": 7})


def drawn(rows: tuple[str, ...], motors: tuple[int, ...]) -> tuple[Lattice, Genotype]:
    mask = np.array([[c == "1" for c in row] for row in rows[::-1]])
    lattice = Lattice(*mask.shape)
    springs = np.zeros(len(lattice.springs), bool)
    expressed = np.flatnonzero(lattice.expressed_springs(mask))
    springs[expressed[list(motors)]] = True
    return lattice, Genotype(mask, springs)


TRIANGLE = ("1",)
RHOMBUS = ("11",)
WHEEL = ("111", "111")  # six triangles around a mass
HOURGLASS = ("1", "1", "0")  # two triangles that share a vertex above each other
TOWER = ("1",) * 6  # three rhombi joined by two vertices
# Stands on four feet, has masses with six springs, hinges nowhere.
BLOCK = ("00111111100", "01111111110", "01111111110")
