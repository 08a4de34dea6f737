"""The integrators: closed forms, order, largest step, and the adjoint of each against differences."""

from __future__ import annotations

import numpy as np
import pytest

from eldir.controller import Controller
from eldir.engine.stable_step import stable_step
from eldir.engine.validity import OK
from eldir.rollout import loss_and_gradient, simulate
from eldir.scene import Scene
from eldir.terrain import Terrain
from tests.eldir.engine.random_robots import SMALL, WEIGHTS, like, moved, norm, robots
from tests.eldir.extreme_robots import extreme, grows, hovering, silent

INTEGRATORS = ("paper", "matched", "second-order")
PAPER = Scene.preset("paper").replace(precision="f64")


def ground(name: str) -> Scene:
    return {
        "flat": PAPER,
        "friction": PAPER.replace(contact="friction"),
        "rugged": PAPER.replace(terrain=Terrain.rugged(np.random.default_rng(2))),
        "climb": PAPER.replace(terrain=Terrain.rugged(np.random.default_rng(3), 0.2)),
        "released": Scene.preset("released-main").replace(precision="f64"),
    }[name]


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("kind", ["flat", "friction", "rugged", "climb", "released"])
def test_the_gradient_is_the_slope_of_the_loss(kind: str, integrator: str) -> None:
    """Along directions in which no mass meets the ground at another step: to 1e-7 of the gradient."""
    scene = ground(kind).replace(integrator=integrator, steps=80)
    (body,), (brain,) = robots(SMALL, 1, 3, scene)
    rng, n = np.random.default_rng(1), 12
    _, (gradient,) = loss_and_gradient([body], [brain], scene)
    directions, steps = [like(brain, rng) for _ in range(n)], (-2e-6, -1e-6, 1e-6, 2e-6)
    sides = [moved(brain, d, h) for d in directions for h in steps]
    losses, _ = loss_and_gradient([body] * len(sides), sides, scene)
    far, near = (losses.reshape(n, 4)[:, k] for k in ([0, 3], [1, 2]))
    slopes = (4 * np.diff(near) / 2e-6 - np.diff(far) / 4e-6)[:, 0] / 3
    landed = [_landings(r.positions, scene) for r in _again(body, sides, scene)]
    smooth = np.array([len({landed[4 * i + k] for k in range(4)}) == 1 for i in range(n)])
    predicted = np.array(
        [sum((getattr(gradient, k) * getattr(d, k)).sum() for k in WEIGHTS) for d in directions]
    )
    assert smooth.sum() >= 4 and norm(gradient) > 0
    assert np.abs(slopes - predicted)[smooth].max() < 1e-7 * norm(gradient)


@pytest.mark.parametrize("damping", [0.0, 15.0])
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_fall_is_exact_as_far_as_the_integrator_is(integrator: str, damping: float) -> None:
    """v = -(g/c) (1 - exp(-c t)); the second-order scheme also has the height, to its order."""
    body = hovering(extreme("triangle"))
    scene = PAPER.replace(integrator=integrator, damping=damping, dt=0.004, steps=200)
    fall = simulate([body], [silent(body)], scene)[0]
    t, g = np.arange(201) * scene.dt, -scene.gravity
    if damping:
        speed, height = (
            -g / damping * (1 - np.exp(-damping * t)),
            -g / damping * (t - (1 - np.exp(-damping * t)) / damping),
        )
    else:
        speed, height = -g * t, -g * t**2 / 2
    off = np.abs(fall.velocities[..., 1].mean(axis=1) - speed).max()
    assert (off < 1e-12) == (integrator != "paper" or damping == 0)
    missed = np.abs((fall.positions - fall.positions[0])[..., 1].mean(axis=1) - height).max()
    bound = {"paper": 0.02, "matched": 0.02, "second-order": 1.0 * g * scene.dt**2}[integrator]
    assert missed < bound and (missed > 2e-4) == (integrator != "second-order")


def test_the_order_in_the_air() -> None:
    """An acting robot in free flight: errors fall with the step, or with its square."""
    bodies, brains = robots(SMALL, 1, 3, PAPER)
    body = hovering(bodies[0])
    orders = {}
    for integrator in INTEGRATORS:
        ends = []
        for n in (200, 400, 800, 6400):
            scene = PAPER.replace(integrator=integrator, stiffness=3e3, dt=0.4 / n, steps=n)
            ends.append(simulate([body], brains, scene)[0].positions[-1])
        errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
        orders[integrator] = np.log2(errors[1] / errors[2])
    assert 0.7 < orders["paper"] < 1.4 and 0.7 < orders["matched"] < 1.4
    assert 1.8 < orders["second-order"] < 2.5, orders


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("damping", [15.0, 400.0])
def test_the_largest_step_of_each(integrator: str, damping: float) -> None:
    body = hovering(extreme("beam"))
    scene = PAPER.replace(gravity=0.0, damping=damping, integrator=integrator, large_step="run", steps=800)
    largest = stable_step(body, scene)
    assert not grows(body, scene.replace(dt=0.98 * largest))
    assert grows(body, scene.replace(dt=1.02 * largest))


def _again(body, sides: list[Controller], scene: Scene):
    rollouts = simulate([body] * len(sides), sides, scene)
    assert all(r.status == OK for r in rollouts)
    return rollouts


def _landings(positions: np.ndarray, scene: Scene) -> bytes:
    """Which masses touch the ground when."""
    x, y = positions[..., 0], positions[..., 1]
    return (np.abs(y - scene.terrain.height(x)) < 1e-9).tobytes()
