"""`python -m benchmarks.validity`: how far gradients and fast robots can be trusted, the tables of
docs/reference/accuracy.md.

Gradients: float32 against float64, and against central differences of the loss, by how much the gradient
has grown. Speeds: robots whose energy grows out of nothing after they hit the ground.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from eldir.benchmark.measurement import big, small, without_motors
from eldir.controller import Controller
from eldir.core.records import FloatArray
from eldir.engine.validity import OK
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.learning import initial_controllers
from eldir.morphology import Morphology, develop
from eldir.physics import Physics
from eldir.rollout import evaluate_gradients, simulate
from eldir.scene import Scene
from eldir.terrain import Terrain

GROWTH = (0.0, 30.0, 300.0, 3e3, 1e4, 1e6, np.inf)
DISTANCES = (1e-5, 1e-3)
"""Distances of the central differences, in the space of the weights."""
SPEEDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9)
"""Way of a mass in one step at the impact, relative to a spring's length."""
_SPRING = 0.05  # length [m]
_PAPER = Scene.preset("paper")


def scenes() -> Iterator[tuple[Scene, list[Morphology]]]:
    """Scenes from those of the paper to the edge of what can be computed, with robots."""
    few, many, robots = small(24, 5)[:12], small(24, 5), big(16, 6)
    rugged = Terrain.rugged(np.random.default_rng(1))
    long = _PAPER.replace(dt=0.002, steps=1000)
    yield from [(_PAPER, many), (_PAPER, robots), (Scene.preset("released-rss"), robots)]
    yield from [(_PAPER.replace(contact="friction"), many), (_PAPER.replace(terrain=rugged), many)]
    yield from [(long.replace(damping=damping), many) for damping in (5.0, 2.0, 0.5, 0.0)]
    yield long.replace(damping=0.0, terrain=rugged), many
    yield _PAPER.replace(steps=4000), many
    yield _PAPER.replace(integrator="second-order", dt=0.001, steps=1000), many
    tiny = [(1e-3, 4000), (1e-4, 10_000), (1e-5, 20_000), (1e-5, 2000), (1e-6, 20_000), (1e-6, 1000)]
    for dt, steps in [*tiny, (1e-7, 5000)]:
        yield _PAPER.replace(dt=dt, steps=steps), few


class GradientErrors(NamedTuple):
    """Robots that completed all steps with a gradient in both precisions, N of them."""

    growth: FloatArray
    """Growth of each gradient in float64, shape (N,)."""
    rounding: FloatArray
    """Difference of the float32 gradient, relative to its length, shape (N,)."""
    differences: FloatArray
    """Difference of each central difference from the gradient's length, relative to it, shape (N, 2)."""


def gradient_errors(scene: Scene, bodies: Sequence[Morphology]) -> GradientErrors:
    """Errors of the gradients of robots with random controllers."""
    brains = initial_controllers(bodies, scene, 3)
    owns = [Physics.of(body, scene) for body in bodies]
    double, single = (
        evaluate_gradients(bodies, brains, scene.replace(precision=precision), owns)
        for precision in ("f64", "f32")
    )
    exact, rounded = ([gradient.flat for gradient in found[1]] for found in (double, single))
    lengths = np.array([np.linalg.norm(gradient) for gradient in exact])
    known = (double.status == OK) & (single.status == OK) & (lengths > 0)
    differences = np.zeros((len(bodies), len(DISTANCES)))
    for k, h in enumerate(DISTANCES):
        losses = []
        for sign in (1, -1):
            moved = [
                brain.shaped(brain.flat + sign * h * gradient / max(length, 1e-300))
                for brain, gradient, length in zip(brains, exact, lengths, strict=True)
            ]
            rollouts = simulate(bodies, moved, scene.replace(precision="f64"))
            losses.append(np.array([rollout.loss for rollout in rollouts]))
        with np.errstate(invalid="ignore", divide="ignore"):
            differences[:, k] = np.abs((losses[0] - losses[1]) / (2 * h) / lengths - 1)
    errors = [
        float(np.linalg.norm(a - b)) / max(length, 1e-300)
        for a, b, length in zip(rounded, exact, lengths, strict=True)
    ]
    return GradientErrors(double.growth[known], np.array(errors)[known], differences[known])


def describe_gradients(found: GradientErrors) -> list[str]:
    """The rows of the table."""
    rows = []
    for low, high in pairwise(GROWTH):
        here = (low <= found.growth) & (found.growth < high)
        if here.any():
            median, ninth = np.quantile(found.rounding[here], [0.5, 0.9])
            fail = 100 * (~(found.differences[here] <= 0.5)).mean(axis=0)
            rows.append(
                f"| {low:g} to {high:g} | {here.sum()} | {median:.0e} ({ninth:.0e}) | "
                + " | ".join(f"{share:.0f} %" for share in fail)
                + " |"
            )
    return rows


def count_gains(scene: Scene, speed: float, robots: int = 24) -> int:
    """Passive robots without damping and gravity that hit the ground at this speed and gain a tenth of their
    kinetic energy or more within two seconds, or diverge."""
    lattice = Lattice(6, 11)
    genotypes = random_genotypes(lattice, robots, np.random.default_rng(0))
    bodies = [without_motors(develop(lattice, genotype)) for genotype in genotypes]
    falling = [0.0, -speed * _SPRING / scene.dt]
    owns = [
        Physics.of(body, scene).replace(velocities=np.tile(falling, (len(body.positions), 1)))
        for body in bodies
    ]
    gained = 0
    for rollout in simulate(bodies, [_silent(body) for body in bodies], scene, owns):
        energy = (rollout.velocities**2).sum(axis=(1, 2))
        gained += rollout.status != OK or energy.max() > 1.1 * energy[0]
    return gained


def _silent(body: Morphology) -> Controller:
    """A controller without motors."""
    inputs = 10 + 4 * len(body.positions)
    return Controller(np.zeros((32, inputs)), np.zeros(32), np.zeros((0, 32)), np.zeros(0))


def impacts() -> dict[str, Scene]:
    """Scenes in which robots hit the ground, by what is written in the table."""
    plain = _PAPER.replace(damping=0.0, gravity=0.0, precision="f64", large_step="run")
    grip = plain.replace(contact="friction")
    rugged = grip.replace(terrain=Terrain.rugged(np.random.default_rng(3)))
    rows = {
        "4 ms, no slip": (plain, 4e-3), "4 ms, friction": (grip, 4e-3), "4 ms, rugged": (rugged, 4e-3),
        "4.4 ms, no slip": (plain, 4.4e-3), "2 ms, no slip": (plain, 2e-3), "2 ms, friction": (grip, 2e-3),
        "2 ms, rugged": (rugged, 2e-3),
    }  # fmt: skip
    return {name: scene.replace(dt=dt, steps=int(2.0 / dt)) for name, (scene, dt) in rows.items()}


def main() -> int:
    """Status 0."""
    parts = [gradient_errors(scene, bodies) for scene, bodies in scenes()]
    found = GradientErrors(*map(np.concatenate, zip(*parts, strict=True)))
    header = " | ".join(f"fail, h = {h:g}" for h in DISTANCES)
    print(f"| growth | robots | float32 against float64 | {header} |\n| --- | --- | --- | --- | --- |")
    print("\n".join(describe_gradients(found)), end="\n\n")
    print("| step, ground | " + " | ".join(f"{speed:g}" for speed in SPEEDS) + " |")
    print("| --- |" + " --- |" * len(SPEEDS))
    for name, scene in impacts().items():
        counts = " | ".join(str(count_gains(scene, speed)) for speed in SPEEDS)
        print(f"| {name} | {counts} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
