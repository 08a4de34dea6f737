"""Random bodies and controllers, and bodies of chosen triangles."""

from __future__ import annotations

import numpy as np

from eldir.controller import Controller
from eldir.core.records import FloatArray
from eldir.genotype import Genotype, random_genotypes
from eldir.lattice import Lattice
from eldir.learning import initial_controllers
from eldir.morphology import Morphology, develop
from eldir.rollout import loss_and_gradient
from eldir.scene import Scene

SMALL = Lattice(6, 11)
WEIGHTS = ("w1", "b1", "w2", "b2")


def moved(brain: Controller, direction: Controller, step: float) -> Controller:
    return Controller(*(getattr(brain, k) + step * getattr(direction, k) for k in WEIGHTS))


def like(brain: Controller, rng: np.random.Generator) -> Controller:
    return Controller(*(rng.standard_normal(getattr(brain, k).shape) for k in WEIGHTS))


def norm(brain: Controller) -> float:
    return float(np.sqrt(sum((getattr(brain, k) ** 2).sum() for k in WEIGHTS)))


def robots(lattice: Lattice, n: int, seed: int, scene: Scene) -> tuple[list[Morphology], list[Controller]]:
    bodies = [develop(lattice, g) for g in random_genotypes(lattice, n, np.random.default_rng(seed))]
    return bodies, initial_controllers(bodies, scene, seed)


def one(triangles: np.ndarray, lattice: Lattice = SMALL, seed: int = 0) -> Morphology:
    """The body of some triangles with half of the springs active."""
    springs = np.random.default_rng(seed).random(len(lattice.springs)) < 0.5
    springs[np.flatnonzero(lattice.expressed_springs(triangles))[0]] = True
    return develop(lattice, Genotype(triangles, springs))


def triangles_at(*cells: tuple[int, int]) -> np.ndarray:
    mask = np.zeros((SMALL.rows, SMALL.columns), bool)
    for row, column in cells:
        mask[row, column] = True
    return mask


def without_motors() -> Morphology:
    """Three triangles with passive springs."""
    return develop(SMALL, Genotype(triangles_at((0, 1), (0, 2), (1, 2)), np.zeros(len(SMALL.springs), bool)))


def learned_numbers() -> FloatArray:
    """Losses and gradients of three robots in float64."""
    scene = Scene.preset("paper").replace(steps=60, precision="f64")
    losses, slopes = loss_and_gradient(*robots(SMALL, 3, 1, scene), scene)
    return np.concatenate([losses, *(getattr(slope, k).ravel() for slope in slopes for k in WEIGHTS)])


def assert_float32_is_close(bodies: list[Morphology], brains: list[Controller], scene: Scene) -> None:
    """Over many robots, as the median: a few are chaotic (docs/reference/engine.md).

    Errors of single robots spread over two decades, so the median of few robots is itself uncertain: four
    draws of 24 robots gave 1.4e-4 to 2.7e-4. The bound of 2e-4 is for 96 robots and more."""
    single, double = (loss_and_gradient(bodies, brains, scene.replace(precision=p)) for p in ("f32", "f64"))
    errors = [norm(moved(a, b, -1.0)) / norm(b) for a, b in zip(single[1], double[1], strict=True)]
    assert np.median(np.abs(single[0] - double[0])) < 1e-6
    assert np.median(errors) < (2e-4 if len(bodies) > 95 else 4e-4)
