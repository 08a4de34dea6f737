"""Gradients of own losses, by JAX through the engine: against central differences, one robot against many."""

import importlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import eldir
from eldir.controller import Controller
from eldir.engine.stable_step import substeps
from eldir.engine.validity import REFUSED
from eldir.errors import InputError, MissingDependencyError
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene
from tests.eldir.engine.random_robots import like, moved, robots
from tests.eldir.random_physics import PAPER, drawn
from tests.eldir.training.gradient_checks import FEW, NAMES, along, product
from tests.raised import raises

jax = pytest.importorskip("jax", reason="JAX is not installed: pip install 'eldir[jax]'")
jnp = jax.numpy

SCENE = PAPER.replace(steps=40)


@pytest.fixture(autouse=True)
def double() -> Iterator[None]:
    with jax.enable_x64(True):
        yield


def walked(rollout: Any) -> Any:
    """Minus the forward displacement, as the engine's own loss."""
    return -jnp.mean(rollout.positions[-1, :, 0] - rollout.positions[0, :, 0])


def effort(rollout: Any) -> Any:
    """What motors and masses do, without the positions."""
    return jnp.mean(rollout.activations**2) + jnp.max(rollout.velocities**2, axis=(1, 2)).mean()


def tracked(rollout: Any, body: Morphology) -> Any:
    """How far the highest mass is from a wave, in three ways at once."""
    top = body.positions[:, 1].argmax()
    wave = body.positions[top, 1] + 0.02 * jnp.sin(jnp.linspace(0, 6, len(rollout.positions)))
    off = rollout.positions[:, top, 1] - wave
    return jnp.sqrt(jnp.mean(off**2)) + 1e-2 * jnp.mean(rollout.velocities[:, top] ** 2) + effort(rollout)


LOSSES = {"displacement": walked, "effort": effort, "tracking": tracked}


def value(loss: Callable[..., Any], body: Morphology, brain: Controller, scene: Scene, own: Physics) -> float:
    """The loss by the engine's rollout alone."""
    rollout = eldir.simulate_one(body, brain, scene, own)
    return float(loss(rollout, body) if loss is tracked else loss(rollout))


def slope(at: Callable[[float], float], sizes: tuple[float, ...] = (1e-4, 1e-5)) -> np.ndarray:
    """Central differences of the fourth order, with these steps."""
    weights = ((-2, 1), (-1, -8), (1, 8), (2, -1))
    return np.array([sum(w * at(k * h) for k, w in weights) / (12 * h) for h in sizes])


@pytest.mark.parametrize("name", LOSSES)
def test_gradients_are_central_differences(name: str) -> None:
    """In all weights, and in each parameter of the physics that the scene has."""
    (body,), (brain,) = robots(FEW, 1, 6, SCENE)
    own, rng, loss = drawn(body, SCENE, 1), np.random.default_rng(4), LOSSES[name]
    found = eldir.value_and_grad(loss)([body], [brain], SCENE, [own])
    assert found.losses[0] == pytest.approx(value(loss, body, brain, SCENE, own), rel=1e-12)
    turn = like(brain, rng)
    slopes = {"weights": slope(lambda h: value(loss, body, moved(brain, turn, h), SCENE, own))}
    predicted = {"weights": product(found.controllers[0], turn)}
    for key in set(NAMES) - {"friction"}:
        size = np.abs(getattr(own, key)).mean()
        way = own.scaled(0.0).replace(**{key: size * rng.standard_normal(np.shape(getattr(own, key)))})
        slopes[key] = slope(lambda h, way=way: value(loss, body, brain, SCENE, along(own, way, h)))
        predicted[key] = product(found.physics[0], way)
    for key, differences in slopes.items():
        off = np.abs(differences - predicted[key])
        assert off.min() <= 1e-7 * abs(predicted[key]) + 1e-10, (key, off, predicted[key])


def test_many_robots_are_as_each_alone() -> None:
    """More robots than are kept at a time, one refused and one that diverges; the engine's own loss."""
    scene = SCENE.replace(steps=10)
    bodies, brains = robots(FEW, 7, 2, scene)
    own = [Physics.of(body, scene) for body in bodies]
    own[3] = own[3].replace(stiffness=1e9)
    own[5] = own[5].replace(velocities=1e3)
    found = eldir.value_and_grad(walked)(bodies, brains, scene, own)
    losses, gradients = eldir.loss_and_gradient(bodies, brains, scene, own)
    good = np.isfinite(losses)
    assert list(np.flatnonzero(~good)) == [3, 5]
    assert found.status[3] == REFUSED and found.status[5] >= 0 and (found.status[good] == -1).all()
    np.testing.assert_allclose(found.losses, losses, rtol=1e-12)
    for ours, theirs in zip(found.controllers, gradients, strict=True):
        np.testing.assert_allclose(ours.flat, theirs.flat, rtol=1e-9, atol=1e-15)
    differentiate = eldir.value_and_grad(tracked)
    together = differentiate(bodies, brains, scene)
    for i in (0, 6):
        alone = differentiate([bodies[i]], [brains[i]], scene)
        assert alone.losses[0] == together.losses[i]
        assert (alone.controllers[0], alone.physics[0]) == (together.controllers[i], together.physics[i])


def test_single_precision_and_divided_steps() -> None:
    """Float32 is near float64, and a robot whose steps are divided is seen at the scene's steps."""
    (body,), (brain,) = robots(FEW, 1, 6, SCENE)
    differentiate = eldir.value_and_grad(tracked)
    exact, rough = (differentiate([body], [brain], SCENE.replace(precision=p)) for p in ("f64", "f32"))
    assert rough.losses[0] == pytest.approx(exact.losses[0], rel=1e-5)
    off = rough.controllers[0].flat - exact.controllers[0].flat
    assert 0 < np.linalg.norm(off) < 1e-3 * np.linalg.norm(exact.controllers[0].flat)
    scene = SCENE.replace(dt=0.012, steps=10, large_step="subdivide")
    found, own = differentiate([body], [brain], scene), Physics.of(body, scene)
    assert substeps([body], scene, [own])[0] > 1
    turn = like(brain, np.random.default_rng(1))
    differences = slope(lambda h: value(tracked, body, moved(brain, turn, h), scene, own))
    predicted = product(found.controllers[0], turn)
    assert np.abs(differences - predicted).min() <= 1e-7 * abs(predicted)


def test_rollouts_are_composed() -> None:
    """Two scenes in one loss, and springs as functions of one number; JAX returns records."""
    import eldir.jax

    (body,), (brain,) = robots(FEW, 1, 6, SCENE)
    low = SCENE.replace(gravity=0.5 * SCENE.gravity)
    nominal = Physics.of(body, SCENE)

    def loss(brain: Controller, stiffer: Any) -> Any:
        springs = {"stiffness": nominal.stiffness * stiffer, "damping": 15.0 + stiffer}
        first, second = (eldir.jax.simulate_one(body, brain, scene, springs) for scene in (SCENE, low))
        return (walked(first) - walked(second)) ** 2 + effort(second)

    def plain(brain: Controller, stiffer: float) -> float:
        own = nominal.replace(stiffness=nominal.stiffness * stiffer, damping=15.0 + stiffer)
        return float(
            (walked(eldir.simulate_one(body, brain, SCENE, own)) - walked(low_rollout(brain, own))) ** 2
            + effort(low_rollout(brain, own))
        )

    def low_rollout(brain: Controller, own: Physics) -> Any:
        return eldir.simulate_one(body, brain, low, own.replace(gravity=low.gravity))

    found, (slopes, by_stiffness) = jax.value_and_grad(loss, argnums=(0, 1))(brain, 0.9)
    turn = like(brain, np.random.default_rng(1))
    assert float(found) == pytest.approx(plain(brain, 0.9), rel=1e-12)
    assert type(slopes) is Controller and slopes.w1.dtype == np.float64
    for predicted, differences in (
        (product(slopes, turn), slope(lambda h: plain(moved(brain, turn, h), 0.9))),
        (float(by_stiffness), slope(lambda h: plain(brain, 0.9 + h))),
    ):
        assert np.abs(differences - predicted).min() <= 1e-7 * abs(predicted)


def test_records_are_pytrees_and_gradients_of_both_interfaces_are_equal() -> None:
    import eldir.jax

    bodies, brains = robots(FEW, 2, 6, SCENE)
    own = [drawn(body, SCENE, 1) for body in bodies]
    assert jax.tree.map(lambda leaf: leaf, (brains, own)) == (brains, own)

    def both(brains: list[Controller], own: list[Physics]) -> Any:
        return sum(map(walked, eldir.jax.simulate(bodies, brains, SCENE, own)))

    slopes, physical = jax.grad(both, argnums=(0, 1))(brains, own)
    found = eldir.value_and_grad(walked)(bodies, brains, SCENE, own)
    assert slopes == list(found.controllers) and physical == list(found.physics)
    burst = [one.replace(velocities=1e3) for one in own]
    assert np.isnan(both(brains, burst))
    assert all(np.isnan(g.flat).all() for g in jax.grad(both)(brains, burst))


@pytest.mark.parametrize(
    ("loss", "code", "key", "match"),
    [
        (lambda r: r.positions[:, 0, 0], "input.wrong-value", "value of the loss", r"shape \(41,\)"),
        (lambda r: None, "input.wrong-value", "value of the loss", "NoneType"),
        (lambda r: jnp.argmax(r.positions), "input.wrong-value", "type of the loss", "int"),
        (lambda r: 1.0, "input.wrong-value", "loss", "does not depend"),
        (lambda r: float(r.positions[0, 0, 0]), "loss.not-traceable", None, "jax.numpy"),
        (lambda r: jnp.mean(jnp.log(-r.positions[..., 1])), "input.wrong-value",
         "value of the loss of robot 0", "nan"),
        (lambda r: jnp.sqrt(0 * r.positions[9, 2, 0]), "loss.no-derivative", None, r"\[9, 2, 0\]"),
        (lambda r, body, more: 0.0, "input.wrong-value", "loss", None),
    ],
)  # fmt: skip
def test_a_wrong_loss_is_named(loss: Callable[..., Any], code: str, key: str, match: str) -> None:
    with raises(InputError, code, key, match=match):
        eldir.value_and_grad(loss)(*robots(FEW, 1, 6, SCENE), SCENE)


def test_wrong_arguments_are_named() -> None:
    import eldir.jax

    bodies, (brain,) = robots(FEW, 1, 6, SCENE)
    weights = {name: getattr(brain, name) for name in ("w1", "b1", "w2", "b2")}

    def height(brain: Any) -> Any:
        return eldir.jax.simulate(bodies, [brain], SCENE)[0].positions.mean()

    with (
        raises(InputError, "input.wrong-value", "Scene.precision", match="jax_enable_x64"),
        jax.enable_x64(False),
    ):
        height(brain)
    with raises(InputError, "loss.traced"):
        jax.jit(height)(brain)
    with raises(InputError, "loss.traced"):
        jax.vmap(height)({name: np.stack([w, w]) for name, w in weights.items()})
    with raises(InputError, "loss.traced"):
        jax.jacrev(lambda b2: eldir.jax.simulate(bodies, [weights | {"b2": b2}], SCENE)[0].positions[-1, 0])(
            brain.b2
        )
    with raises(InputError, "input.wrong-shape", "w1 of controller 0"):
        height(weights | {"w1": brain.w1[:, :-1]})
    with raises(InputError, "input.wrong-value", "controller 0", match="finite"):
        height(weights | {"b1": np.full(32, np.nan)})
    with raises(InputError, "input.wrong-value", "arrays of a controller", match="w1, b1, w2, b2"):
        height({"w1": brain.w1})
    with raises(InputError, "input.unknown-name", "field of physics"):
        eldir.jax.simulate(bodies, [brain], SCENE, [{"mass": 1.0}])
    with raises(InputError, "input.wrong-number", "controllers"):
        eldir.jax.simulate(bodies, [], SCENE)
    with raises(InputError, "input.wrong-value", "Scene.window"):
        eldir.value_and_grad(walked)(bodies, [brain], SCENE.replace(window=5))


def test_without_jax_or_torch_what_to_install_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("jax", "torch"):
        monkeypatch.setitem(sys.modules, module, None)
    names = ("jax", "jax.rollouts", "jax._pytrees", "torch", "torch._rollouts")
    for name in names:
        monkeypatch.delitem(sys.modules, f"eldir.{name}", raising=False)
    for use in (lambda: eldir.value_and_grad(walked), lambda: importlib.import_module("eldir.jax")):
        with raises(MissingDependencyError, "missing-package", match=r"pip install 'eldir\[jax\]'"):
            use()
    with raises(MissingDependencyError, "missing-package", match="pip install torch"):
        importlib.import_module("eldir.torch")
