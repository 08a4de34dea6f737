"""`python -m benchmarks.own_loss`: what own losses with JAX cost, the table of docs/how-to/own-loss.md.

The engine's own loss, the gradient with the cotangents ready, and the same displacement as a function of JAX,
in turns on one thread: processor time of all of them, and its ratio to the first within a turn.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import eldir
import eldir.jax
from eldir.benchmark.measurement import big, small
from eldir.benchmark.other_programs import watch_other_programs
from eldir.learning import initial_controllers
from eldir.scene import Scene
from eldir.training.gradients import motion_gradient

TURNS = 9
CASES = (
    ("small", small, 200, "f32"),
    ("small", small, 200, "f64"),
    ("big", big, 50, "f32"),
    ("big", big, 50, "f64"),
)


def walked(rollout: Any) -> Any:
    """Minus the forward displacement [m]."""
    return -jnp.mean(rollout.positions[-1, :, 0] - rollout.positions[0, :, 0])


def with_effort(rollout: Any) -> Any:
    """The same, with velocities and activations."""
    return walked(rollout) + 1e-3 * (jnp.mean(rollout.velocities**2) + jnp.mean(rollout.activations**2))


def measure(bodies: list[eldir.Morphology], scene: Scene) -> dict[str, list[float]]:
    """Seconds of processor time in each turn, after one that compiles."""
    controllers = initial_controllers(bodies, scene, 1)
    own, complete = eldir.value_and_grad(walked), eldir.value_and_grad(with_effort)
    compiled = jax.jit(walked)

    def composed() -> None:
        def total(controllers: list[eldir.Controller]) -> Any:
            return sum(map(compiled, eldir.jax.simulate(bodies, controllers, scene)))

        jax.grad(total)(controllers)

    def by_hand() -> None:
        cotangents = []
        for rollout in eldir.simulate(bodies, controllers, scene):
            cotangents.append(np.zeros_like(rollout.positions))
            cotangents[-1][-1, :, 0] = -1 / rollout.positions.shape[1]
        motion_gradient(bodies, controllers, scene, cotangents=cotangents)

    ways: dict[str, Callable[[], object]] = {
        "the engine's own loss": lambda: motion_gradient(bodies, controllers, scene),
        "`eldir.value_and_grad`, positions": lambda: own(bodies, controllers, scene),
        "`eldir.value_and_grad`, all": lambda: complete(bodies, controllers, scene),
        "`simulate`, `motion_gradient` with derivatives by hand": by_hand,
        "`jax.grad` over `eldir.jax.simulate`, loss compiled": composed,
    }
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(TURNS + 1):
        for name, way in ways.items():
            began, spent = time.perf_counter(), time.process_time()
            way()
            if turn:
                seconds[name].append(time.process_time() - spent)
            else:
                print(f"  first {name}: {time.perf_counter() - began:.1f} s", file=sys.stderr)
    return seconds


def main() -> int:
    """The table on stdout."""
    os.environ["ELDIR_THREADS"] = "1"
    jax.config.update("jax_enable_x64", True)
    print("| robots | gradient of | processor time | ratio |")
    print("| --- | --- | --- | --- |")
    with watch_other_programs() as others:
        _print_rows()
    print(f"\n{others.describe()}")
    return 0


def _print_rows() -> None:
    for kind, make, robots, precision in CASES:
        seconds = measure(make(robots, 5), Scene.preset("paper").replace(precision=precision))
        base = np.array(seconds["the engine's own loss"])
        for name, values in seconds.items():
            ratio = np.array(values) / base
            spread = f"{np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f})"
            print(
                f"| {robots} {kind}, {precision} | {name} | {np.median(values):.3f} s | {spread} |",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
