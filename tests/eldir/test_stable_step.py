"""The largest stable step of a robot against what the engine does, and what becomes of larger ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.engine.stable_step import eigenvalue_bounds, is_stable, largest_eigenvalue, stable_step, substeps
from eldir.engine.validity import OK, REFUSED
from eldir.errors import EldirError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.learning import initial_controllers, learn
from eldir.morphology import Bodies, develop
from eldir.physics import Physics, resolve_physics
from eldir.rollout import Rollout, loss_and_gradient, simulate
from eldir.scene import Scene
from eldir.terrain import Terrain
from tests.eldir.extreme_robots import extreme, grows, hovering, silent
from tests.raised import raises

PAPER = Scene.preset("paper")
EXTREME = ("triangle", "hinge", "beam", "tower", "lattice", "passive", "all active", "coincident")


@pytest.mark.parametrize("damping", [0.0, 15.0, 400.0])
@pytest.mark.parametrize("name", ["triangle", "hinge", "beam", "lattice", "passive"])
def test_the_largest_step_is_where_the_engine_blows_up(name: str, damping: float) -> None:
    body = hovering(extreme(name))
    scene = PAPER.replace(gravity=0.0, damping=damping, precision="f64", large_step="run", steps=800)
    largest = stable_step(body, scene)
    assert not grows(body, scene.replace(dt=0.98 * largest))
    assert grows(body, scene.replace(dt=1.02 * largest))


def test_the_bound_bounds_and_the_presets_pass_by_it() -> None:
    lattice = Lattice()
    bodies = [develop(lattice, g) for g in random_genotypes(lattice, 20, np.random.default_rng(1))]
    for body in bodies:
        assert 5.3 < largest_eigenvalue(body, Physics.of(body, PAPER)) / PAPER.stiffness < 6.0
    bodies += [extreme(n) for n in EXTREME]
    physics = resolve_physics(bodies, PAPER, None)
    for body, own, bound in zip(bodies, physics, eigenvalue_bounds(Bodies(bodies), physics), strict=True):
        assert largest_eigenvalue(body, own) <= bound * (1 + 1e-12)
    # By the bound alone, so that no eigenvalue is ever computed for them.
    for preset in ("paper", "released-rss", "released-main"):
        assert is_stable(bodies, Scene.preset(preset)).all()


def test_a_step_that_is_too_large_for_all_is_refused_with_the_numbers() -> None:
    body = extreme("triangle")
    scene = PAPER.replace(dt=0.02)
    for refused in (simulate, loss_and_gradient):
        with raises(EldirError, "scene.large-step", match=r"Scene\.dt at most 6\.\d* ms; found 20 ms"):
            refused([body], [silent(body)], scene)
    with raises(EldirError, "scene.large-step"):
        learn([body, extreme("beam")], scene, 1)


def test_a_robot_that_is_refused_does_not_touch_the_others() -> None:
    soft, stiff = extreme("triangle"), extreme("lattice")
    scene = PAPER.replace(dt=0.0055, steps=60)  # between their limits
    assert is_stable([soft, stiff], scene).tolist() == [True, False]
    bodies = [stiff, soft, stiff]
    brains = initial_controllers(bodies, scene, 1)
    rollouts = simulate(bodies, brains, scene)
    assert [r.status for r in rollouts] == [REFUSED, OK, REFUSED]
    assert rollouts[1] == simulate([soft], brains[1:2], scene)[0]
    assert np.isnan(rollouts[0].positions).all() and rollouts[0].loss == np.inf
    assert rollouts[0].activations.shape == (60, stiff.motors)
    losses, gradients = loss_and_gradient(bodies, brains, scene)
    assert np.isfinite(losses).tolist() == [False, True, False] and not gradients[0].w1.any()
    assert gradients[1].w1.any()
    trained = learn(bodies, scene, 2, controllers=brains)
    assert trained.status.tolist() == [REFUSED, OK, REFUSED]
    assert np.isinf(trained.losses[[0, 2]]).all() and np.isfinite(trained.losses[1]).all()
    assert trained.controllers[0] == brains[0] and trained.controllers[1] != brains[1]


def test_steps_are_divided_where_the_scene_says_so() -> None:
    soft, stiff = extreme("triangle"), extreme("lattice")
    scene = PAPER.replace(dt=0.0055, steps=60, large_step="subdivide", precision="f64")
    bodies, parts = [stiff, soft, stiff], 2
    assert substeps(bodies, scene).tolist() == [parts, 1, parts]
    brains = initial_controllers(bodies, scene, 1)
    rollouts = simulate(bodies, brains, scene)
    assert [r.status for r in rollouts] == [OK] * 3
    assert rollouts[1] == simulate([soft], brains[1:2], scene.replace(large_step="refuse"))[0]
    (finer,) = simulate([stiff], brains[:1], scene.replace(dt=0.0055 / parts, steps=60 * parts))
    assert rollouts[0].positions.tobytes() == finer.positions[::parts].tobytes()
    assert rollouts[0].activations.tobytes() == finer.activations[::parts].tobytes()
    losses, gradients = loss_and_gradient(bodies, brains, scene)
    assert losses.tolist() == [r.loss for r in rollouts] and gradients[0].w1.any()
    counted: list[int] = []
    trained = learn(bodies, scene, 2, controllers=brains, progress=counted.append)
    assert np.isfinite(trained.losses).all() and trained.losses[:, 0].tolist() == losses.tolist()
    assert counted == [1, 3]


def test_a_divided_step_that_blows_up_is_counted_in_the_scenes_steps() -> None:
    """Speeds grow by 5.2 m/s in 4 ms, and a mass may not move by 0.05 m in them, at 12.5 m/s."""
    body = extreme("triangle")
    scene = PAPER.replace(dt=0.008, gravity=1.3e3, steps=30, large_step="subdivide")
    assert substeps([body], scene).tolist() == [2]
    (rollout,) = simulate([body], [silent(body)], scene)
    assert rollout.status == 1 and np.isnan(rollout.positions[2:]).all()
    assert np.isfinite(rollout.positions[:2]).all() and rollout.loss == np.inf


@pytest.mark.parametrize("terrain", ["flat", "friction", "rugged", "steep"])
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_no_nan_leaves_the_engine_unflagged(terrain: str, precision: str) -> None:
    """Extreme bodies side by side; whoever is not fine says so, and nobody's neighbour notices."""
    ground = {
        "rugged": Terrain.rugged(np.random.default_rng(1)),
        "steep": Terrain.from_segments(np.array([-1.0, 0.1]), np.array([0.0, 3.0]), np.array([0.1, -0.2])),
    }.get(terrain, Terrain.flat())
    scene = PAPER.replace(terrain=ground, precision=precision, steps=150, large_step="run")
    if terrain == "friction":
        scene = scene.replace(contact="friction")
    bodies = [extreme(n) for n in EXTREME]
    bodies.append(replace(bodies[1], rest_lengths=np.full(len(bodies[1].springs), 1e30)))  # bursts at once
    bodies.append(replace(bodies[0], positions=bodies[0].positions - [0, 0.09]))  # deep in the ground
    brains = initial_controllers(bodies, scene, 0)
    rollouts = simulate(bodies, brains, scene)
    losses, gradients = loss_and_gradient(bodies, brains, scene)
    for i, (rollout, gradient) in enumerate(zip(rollouts, gradients, strict=True)):
        assert flagged(rollout) and (losses[i] == rollout.loss)
        assert all(np.isfinite(getattr(gradient, k)).all() for k in ("w1", "b1", "w2", "b2"))
    assert rollouts[len(EXTREME)].status == 0
    assert [r.status for r in rollouts[:7]] == [OK] * 7
    alone = [simulate([b], [c], scene)[0] for b, c in zip(bodies, brains, strict=True)]
    assert all(same(a, b) for a, b in zip(rollouts, alone, strict=True))


def flagged(rollout: Rollout) -> bool:
    last = rollout.status if rollout.status != OK else len(rollout.positions) - 1
    sound = (
        np.isfinite(rollout.positions[: last + 1]).all() and np.isfinite(rollout.velocities[: last + 1]).all()
    )
    return bool(sound and np.isfinite(rollout.loss) == (rollout.status == OK))


def same(a: Rollout, b: Rollout) -> bool:
    return a.positions.tobytes() == b.positions.tobytes() and a.status == b.status and a.loss == b.loss


@pytest.mark.parametrize("stiffness", [1e12, 1e30, 1e37])
def test_speeds_at_the_limit_of_floats_are_told(stiffness: float) -> None:
    body = replace(extreme("triangle"), rest_lengths=np.full(3, 0.06))
    scene = PAPER.replace(stiffness=stiffness, steps=20, large_step="run")
    for precision in ("f32", "f64"):
        (rollout,) = simulate([body], [silent(body)], scene.replace(precision=precision))
        assert rollout.status == 0 and rollout.loss == np.inf and flagged(rollout)


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_landing_exactly_at_a_corner(precision: str) -> None:
    """A mass falls straight down onto where two segments meet, between a climb and a descent."""
    body = extreme("triangle")
    # Highest, 0.1 m, at x = 0.05 m.
    ridge = Terrain.from_segments(np.array([-1.0, 0.05]), np.array([0.5, -0.5]), np.array([0.075, 0.125]))
    inverted = replace(body, positions=np.array([[0.025, 0.16], [0.05, 0.12], [0.075, 0.16]]))
    scene = PAPER.replace(terrain=ridge, precision=precision, steps=400, large_step="run")
    (rollout,) = simulate([inverted], [silent(inverted)], scene)
    losses, (gradient,) = loss_and_gradient([inverted], [silent(inverted)], scene)
    assert rollout.status == OK and np.isfinite(losses).all() and np.isfinite(gradient.w1).all()
    under = scene.terrain.height(rollout.positions[..., 0]) - rollout.positions[..., 1]
    assert under.max() < 1e-6 and np.abs(under).min() < 1e-6  # it landed, and nothing sank
