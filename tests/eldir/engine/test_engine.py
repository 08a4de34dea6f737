"""The engine against the released code's trajectories, a twin in NumPy, and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from eldir.controller import Controller
from eldir.engine.validity import OK
from eldir.errors import InputError
from eldir.genotype import Genotype, random_genotypes
from eldir.lattice import Lattice
from eldir.learning import learn
from eldir.morphology import Morphology, develop
from eldir.physics import Physics
from eldir.rollout import loss_and_gradient, losses, simulate
from eldir.scene import Scene
from eldir.terrain import Terrain
from eldir.training.configuration import TrainingConfig
from tests.eldir.engine.random_robots import (
    SMALL,
    WEIGHTS,
    assert_float32_is_close,
    like,
    moved,
    norm,
    one,
    robots,
    triangles_at,
)
from tests.eldir.engine.twin import paper_rollout
from tests.paths import DATA
from tests.raised import raises

GOLDEN = {"rss_flat": "released-rss", "main_flat": "released-main", "main_rugged": "released-main"}


def golden(name: str) -> tuple[dict, Morphology, Controller, Scene]:
    """One robot of the released code; its two constant inputs are folded into the hidden bias."""
    data = dict(np.load(DATA / f"{name}_small_s1.npz"))
    body = develop(SMALL, Genotype(data["body_mask"].astype(bool), data["spring_geno"].astype(bool)))
    used = 10 + 4 * len(body.positions)
    w1, on = data["w1_init"], body.active
    brain = Controller(
        w1[:, :used], data["b1_init"] + w1[:, used:].sum(axis=1), data["w2_init"][on], data["b2_init"][on]
    )
    scene = Scene.preset(GOLDEN[name]).replace(precision="f64")
    if "terrain_segs" in data:
        x0, _, _, slope, intercept = data["terrain_segs"]
        scene = scene.replace(terrain=Terrain.from_segments(x0, slope, intercept))
    return data, body, brain, scene


@pytest.mark.compiler
@pytest.mark.parametrize("name", GOLDEN)
def test_released_code_moves_the_same(name: str) -> None:
    data, body, brain, scene = golden(name)
    rollout = simulate([body], [brain], scene)[0]
    assert rollout.status == OK
    assert np.abs(rollout.positions[data["t_saved"]] - data["x_init"]).max() < 1e-9
    assert np.abs(rollout.velocities[data["t_saved"]] - data["v_init"]).max() < 1e-7
    assert np.abs(rollout.positions[:21] - data["x_first20"]).max() < 1e-9
    assert np.abs(rollout.positions.mean(axis=1) - data["center_init"]).max() < 1e-9
    acted = data["t_saved"][:-1]
    assert np.abs(rollout.activations[acted] - data["act_init"][:-1, body.active]).max() < 1e-8
    assert abs(rollout.loss - data["loss_hist"][0]) < 1e-9


@pytest.mark.compiler
@pytest.mark.parametrize("states", [10, 50, 200, 1000])
def test_gradient_is_the_exact_one(states: int) -> None:
    data, body, brain, scene = golden("rss_flat")
    losses, (gradient,) = loss_and_gradient([body], [brain], scene.replace(steps=states - 1))
    suffix = "" if states == 1000 else f"_T{states}"
    for key in WEIGHTS:
        exact = data[f"truegrad_{key}{suffix}"]
        exact = exact[:, : brain.w1.shape[1]] if key == "w1" else exact
        exact = exact[body.active] if key in ("w2", "b2") else exact
        assert np.linalg.norm(getattr(gradient, key) - exact) <= 1e-8 * np.linalg.norm(exact), key
    if suffix:
        assert abs(losses[0] - data[f"loss{suffix}"]) < 1e-12


@pytest.mark.compiler
@pytest.mark.parametrize("name", ["main_flat", "main_rugged", "climb", "descent"])
def test_gradient_with_friction_is_the_slope_of_the_loss(name: str) -> None:
    if name in GOLDEN:
        _, body, brain, scene = golden(name)
    else:
        ground = Terrain.rugged(np.random.default_rng(2), 0.2 if name == "climb" else -0.2)
        scene = Scene.preset("paper").replace(terrain=ground, precision="f64")
        (body,), (brain,) = robots(SMALL, 1, 3, scene)
    scene, h, rng = scene.replace(steps=60), 1e-6, np.random.default_rng(1)
    _, (gradient,) = loss_and_gradient([body], [brain], scene)
    directions = [like(brain, rng) for _ in range(20)]
    sides = [moved(brain, d, s) for d in directions for s in (-h, h)]
    losses, _ = loss_and_gradient([body] * 40, sides, scene)
    touching = [
        np.abs(r.positions[:, :, 1] - scene.terrain.height(r.positions[:, :, 0])) < 1e-12
        for r in simulate([body] * 40, sides, scene)
    ]
    smooth = [np.array_equal(touching[2 * i], touching[2 * i + 1]) for i in range(20)]
    slopes = (losses[1::2] - losses[::2]) / (2 * h)
    predicted = np.array(
        [sum((getattr(gradient, k) * getattr(d, k)).sum() for k in WEIGHTS) for d in directions]
    )
    assert np.sum(smooth) >= 10
    error = np.abs(slopes - predicted)[smooth]
    assert error.max() < 1e-6 * norm(gradient)


def _twin_cases() -> dict[str, tuple[Morphology, Scene]]:
    def rugged(seed: int, tilt: float = 0.0) -> Terrain:
        return Terrain.rugged(np.random.default_rng(seed), tilt)

    paper, rss, main = (Scene.preset(n) for n in ("paper", "released-rss", "released-main"))
    some = [develop(SMALL, g) for g in random_genotypes(SMALL, 4, np.random.default_rng(3))]
    return {
        "triangle": (one(triangles_at((0, 1))), paper),
        "hinge": (one(triangles_at((0, 1), (1, 1))), paper),
        "whole lattice": (one(np.ones((13, 22), bool), Lattice()), rss),
        "paper": (some[0], paper),
        "paper rugged": (some[1], paper.replace(terrain=rugged(1))),
        "paper climb": (some[2], paper.replace(terrain=rugged(2, 0.2))),
        "paper descent": (some[2], paper.replace(terrain=rugged(3, -0.2))),
        "main flat": (some[3], main),
        "main rugged": (some[0], main.replace(terrain=rugged(4))),
        "free flight": (some[1], paper.replace(contact="none")),
        "open loop": (some[2], paper.replace(sensing="none")),
        "open loop on rugged ground": (some[3], paper.replace(sensing="none", terrain=rugged(5))),
        "no damping": (some[1], main.replace(damping=0.0, dt=0.002)),
        "matched": (some[0], paper.replace(integrator="matched")),
        "matched rugged": (some[2], paper.replace(terrain=rugged(1), integrator="matched")),
        "second order": (some[0], paper.replace(integrator="second-order")),
        "second order rugged": (some[1], paper.replace(terrain=rugged(2), integrator="second-order")),
        "second order, no damping": (some[1], main.replace(damping=0.0, dt=0.002, integrator="second-order")),
    }


@pytest.mark.parametrize("name", _twin_cases())
def test_twin_moves_the_same(name: str) -> None:
    body, scene = _twin_cases()[name]
    scene = scene.replace(precision="f64", steps=60)
    brain = Controller.random(len(body.positions), body.motors, np.random.default_rng(5))
    rollout = simulate([body], [brain], scene)[0]
    x, v, a = paper_rollout(body, brain, scene)
    assert np.abs(rollout.positions - x).max() < 1e-10
    assert np.abs(rollout.velocities - v).max() < 1e-8
    assert np.abs(rollout.activations - a).max() < 1e-9
    assert abs(rollout.loss + (x[-1] - x[0])[:, 0].mean()) < 1e-12


@pytest.mark.compiler
def test_bytes_depend_neither_on_threads_nor_on_company(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene.preset("paper").replace(steps=120)
    bodies, brains = robots(SMALL, 9, 4, scene)
    turned = list(range(9))[::-1]
    monkeypatch.setenv("ELDIR_THREADS", "1")
    one_thread = learn(bodies, scene, 2, controllers=brains)
    monkeypatch.setenv("ELDIR_THREADS", "2")
    two_threads = learn([bodies[i] for i in turned], scene, 2, controllers=[brains[i] for i in turned])
    assert one_thread.losses.tobytes() == two_threads.losses[turned].tobytes()
    for i in range(9):
        for key in WEIGHTS:
            mine, other = (getattr(r.controllers[k], key) for r, k in ((one_thread, i), (two_threads, 8 - i)))
            assert mine.tobytes() == other.tobytes()


@pytest.mark.compiler
def test_single_precision_gradients_are_close() -> None:
    scene = Scene.preset("paper").replace(steps=200)
    assert_float32_is_close(*robots(SMALL, 32, 6, scene), scene)


@pytest.mark.compiler
@pytest.mark.parametrize(("preset", "bias_gain"), [("paper", 1), ("released-rss", 3)])
def test_learning_follows_the_normalised_gradient(preset: str, bias_gain: int) -> None:
    scene = Scene.preset(preset).replace(precision="f64", steps=300)
    bodies, brains = robots(SMALL, 4, 7, scene)
    result = learn(bodies, scene, 4, controllers=brains)
    losses, trained, trail = [], list(brains), []
    for _ in range(5):
        loss, gradients = loss_and_gradient(bodies, trained, scene)
        losses.append(loss)
        trail.append(trained)
        updated = []
        for brain, g in zip(trained, gradients, strict=True):
            length = np.sqrt(norm(g) ** 2 + (bias_gain - 1) * (g.b1**2).sum())
            step = TrainingConfig().update_length / (length + 1e-6)
            new = moved(brain, g, -step)
            updated.append(Controller(new.w1, brain.b1 - bias_gain * step * g.b1, new.w2, new.b2))
        trained = updated
    expected = np.array(losses).T
    assert np.abs(result.losses - expected).max() < 1e-7
    for i, best in enumerate(expected.argmin(axis=1)):
        for key in WEIGHTS:
            kept, found = getattr(trail[best][i], key), getattr(result.controllers[i], key)
            assert np.allclose(found, kept, atol=1e-6)


@pytest.mark.compiler
def test_robots_that_blow_up_are_told() -> None:
    stiff = Scene.preset("paper").replace(steps=200, stiffness=1e9, large_step="run")
    bodies, brains = robots(SMALL, 3, 8, stiff)
    losses, gradients = loss_and_gradient(bodies, brains, stiff)
    assert (losses == np.inf).all() and all(norm(g) == 0 for g in gradients)
    for rollout in simulate(bodies, brains, stiff):
        assert rollout.status >= 0 and rollout.loss == np.inf
        assert np.isnan(rollout.positions[rollout.status + 1 :]).all()
        assert np.isfinite(rollout.positions[: rollout.status]).all()
    trained = learn(bodies, stiff, 2, controllers=brains)
    assert np.isinf(trained.losses).all() and (trained.status >= 0).all()
    assert all(np.array_equal(a.w1, b.w1) for a, b in zip(trained.controllers, brains, strict=True))


@pytest.mark.compiler
def test_neighbours_of_a_robot_that_blew_up_are_untouched() -> None:
    scene = Scene.preset("paper").replace(steps=100)
    bodies, brains = robots(SMALL, 3, 8, scene)
    body = bodies[1]
    huge = np.full(len(body.springs), 1e9)
    bursting = Morphology(
        body.positions, body.springs, huge, body.active, body.vertices, body.lattice_springs
    )
    alone = loss_and_gradient([bodies[0], bodies[2]], [brains[0], brains[2]], scene)
    among = loss_and_gradient([bodies[0], bursting, bodies[2]], brains, scene)
    assert np.isinf(among[0][1]) and norm(among[1][1]) == 0
    assert among[0][[0, 2]].tobytes() == alone[0].tobytes()
    for mine, other in zip([among[1][0], among[1][2]], alone[1], strict=True):
        assert all(getattr(mine, k).tobytes() == getattr(other, k).tobytes() for k in WEIGHTS)


@pytest.mark.parametrize(("large_step", "refused"), [("refuse", True), ("subdivide", False)])
def test_losses_alone_are_those_of_rollouts(large_step: str, refused: bool) -> None:
    """Also of a robot that comes twice, and of one that is refused or whose steps are divided."""
    scene = Scene.preset("paper").replace(steps=100, large_step=large_step)
    bodies, brains = robots(SMALL, 3, 8, scene)
    bodies, brains = [*bodies, bodies[0]], [*brains, brains[0]]
    own = [Physics.of(body, scene) for body in bodies]
    own[1] = own[1].replace(stiffness=4 * scene.stiffness)
    expected = [rollout.loss for rollout in simulate(bodies, brains, scene, own)]
    assert losses(bodies, brains, scene, own).tolist() == expected
    assert expected[0] == expected[3] and np.isinf(expected).tolist() == [False, refused, False, False]
    assert losses([], [], scene).shape == (0,)


@pytest.mark.compiler
def test_falling_straight_down_gives_no_nan() -> None:
    """Exactly zero tangential velocity: the released code divides 0 by 0 here."""
    body = one(triangles_at((0, 1)))
    at, (a, b) = body.positions + np.array([0, 0.02]), body.springs.T
    unstressed = np.linalg.norm(at[a] - at[b], axis=1) + 1e-4  # the length that the engine sees
    lifted = Morphology(at, body.springs, unstressed, body.active, body.vertices, body.lattice_springs)
    still = Controller(np.zeros((32, 22)), np.zeros(32), np.zeros((body.motors, 32)), np.zeros(body.motors))
    scene = Scene.preset("paper").replace(contact="friction", precision="f64", steps=200)
    rollout = simulate([lifted], [still], scene)[0]
    losses, (gradient,) = loss_and_gradient([lifted], [still], scene)
    assert rollout.positions[-1, :, 1].min() < 0.1 + 1e-6  # it did land
    assert np.isfinite(rollout.positions).all() and np.isfinite(losses).all()
    assert all(np.isfinite(getattr(gradient, k)).all() for k in WEIGHTS)


def test_a_robot_without_motors_stands_still() -> None:
    body = one(triangles_at((0, 1), (0, 2), (0, 3)))
    passive = Morphology(
        body.positions, body.springs, body.rest_lengths, np.zeros(len(body.springs), bool),
        body.vertices, body.lattice_springs,
    )  # fmt: skip
    brain = Controller(
        np.ones((32, 10 + 4 * len(body.positions))), np.ones(32), np.zeros((0, 32)), np.zeros(0)
    )
    rollout = simulate([passive], [brain], Scene.preset("paper"))[0]
    assert rollout.activations.shape == (999, 0) and rollout.status == OK
    assert abs(rollout.loss) < 2e-3
    losses, (gradient,) = loss_and_gradient([passive], [brain], Scene.preset("paper"))
    assert losses[0] == pytest.approx(rollout.loss) and norm(gradient) == 0 and gradient.w2.shape == (0, 32)


def test_controllers_that_do_not_fit_are_named() -> None:
    scene = Scene.preset("paper").replace(steps=2)
    bodies, brains = robots(SMALL, 2, 9, scene)
    with raises(InputError, "input.wrong-number", "controllers"):
        simulate(bodies, brains[:1], scene)
    with raises(InputError, "input.wrong-shape", "w1 of controller 0"):
        simulate(bodies, brains[::-1], scene)
    bad = Controller(brains[1].w1 * np.nan, brains[1].b1, brains[1].w2, brains[1].b2)
    with raises(InputError, "input.wrong-value", "controller 1"):
        loss_and_gradient(bodies, [brains[0], bad], scene)
    with raises(InputError, "input.wrong-value", "iterations"):
        learn(bodies, scene, 0)
    assert simulate([], [], scene) == [] and loss_and_gradient([], [], scene)[1] == []


@pytest.mark.parametrize("key", ["contact", "sensing", "weights", "precision"])
def test_a_scene_that_the_engine_does_not_know_is_named(key: str) -> None:
    with raises(InputError, "scene.wrong-value", key):
        Scene.preset("paper").replace(**{key: "ice"})


@pytest.mark.parametrize("text", ["0", "many", "-1"])
def test_a_wrong_number_of_threads_is_named(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ELDIR_THREADS", text)
    scene = Scene.preset("paper").replace(steps=2)
    bodies, brains = robots(SMALL, 1, 9, scene)
    with raises(InputError, "input.wrong-value", "ELDIR_THREADS"):
        simulate(bodies, brains, scene)
