"""Rollouts that PyTorch differentiates: against central differences and against the engine's own loss."""

from typing import Any

import numpy as np
import pytest

import eldir
from eldir.controller import Controller
from eldir.errors import InputError
from eldir.physics import Physics
from eldir.scene import Scene
from eldir.training.gradients import motion_gradient
from tests.eldir.engine.random_robots import like, moved, robots
from tests.eldir.random_physics import PAPER
from tests.eldir.training.gradient_checks import FEW
from tests.raised import raises

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install torch")
import eldir.torch as rollouts  # noqa: E402

SCENE = PAPER.replace(steps=40)


def walked(rollout: Any) -> Any:
    """Minus the forward displacement, as the engine's own loss."""
    return -(rollout.positions[-1, :, 0] - rollout.positions[0, :, 0]).mean()


def lively(rollout: Any) -> Any:
    """All parts of a rollout."""
    return walked(rollout) + 0.1 * (rollout.activations**2).mean() + (rollout.velocities**2).mean()


def test_gradients_are_central_differences() -> None:
    """Of two scenes in one loss, with respect to weights and to a number that all springs depend on."""
    (body,), (brain,) = robots(FEW, 1, 6, SCENE)
    low, nominal = SCENE.replace(gravity=0.5 * SCENE.gravity), Physics.of(body, SCENE)

    def value(weights: Any, stiffer: Any) -> Any:
        springs = {"stiffness": torch.tensor(nominal.stiffness) * stiffer, "damping": 15.0 + stiffer}
        first, second = (rollouts.simulate_one(body, weights, scene, springs) for scene in (SCENE, low))
        return (walked(first) - walked(second)) ** 2 + lively(second)

    weights = rollouts.parameters(brain)
    stiffer = torch.tensor(0.9, dtype=torch.float64, requires_grad=True)
    value(weights, stiffer).backward()
    turn = like(brain, np.random.default_rng(1))
    by_weights = sum(float((weights[k].grad.numpy() * getattr(turn, k)).sum()) for k in weights)
    for predicted, at in (
        (by_weights, lambda h: value(moved(brain, turn, h), torch.tensor(0.9))),
        (stiffer.grad.item(), lambda h: value(brain, torch.tensor(0.9 + h, dtype=torch.float64))),
    ):
        ends = [float(at(k * 1e-4)) for k in (-2, -1, 1, 2)]
        assert np.dot([1, -8, 8, -1], ends) / 12e-4 == pytest.approx(predicted, rel=1e-6)


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_many_robots_have_the_gradients_of_the_engine(precision: Any) -> None:
    """One of them diverges; tensors are in the scene's precision, gradients in the parameters'."""
    scene: Scene = SCENE.replace(steps=10, precision=precision)
    bodies, brains = robots(FEW, 3, 2, scene)
    own = [Physics.of(body, scene) for body in bodies]
    own[1] = own[1].replace(velocities=1e3)
    exact = motion_gradient(bodies, brains, scene, own)
    weights, springs = ([rollouts.parameters(one) for one in records] for records in (brains, own))
    found = rollouts.simulate(bodies, weights, scene, springs)
    assert found[0].positions.dtype == {"f32": torch.float32, "f64": torch.float64}[precision]
    sum(map(walked, found)).backward()
    assert all(torch.isnan(w.grad).all() for w in (*weights[1].values(), *springs[1].values()))
    tolerance = {"f32": 1e-4, "f64": 1e-9}[precision]
    for i in (0, 2):
        for tensors, record in ((weights[i], exact.controllers[i]), (springs[i], exact.physics[i])):
            for name, tensor in tensors.items():
                wanted = np.asarray(getattr(record, name))
                size = np.abs(wanted).max() + 1e-15
                np.testing.assert_allclose(tensor.grad.numpy(), wanted, rtol=0, atol=tolerance * size)


def test_optimisers_of_torch_take_the_parameters() -> None:
    (body,), (brain,) = robots(FEW, 1, 6, SCENE)
    weights = rollouts.parameters(brain)
    optimiser = torch.optim.SGD(weights.values(), lr=0.1)
    losses = []
    for _ in range(3):
        optimiser.zero_grad()
        loss = walked(rollouts.simulate_one(body, weights, SCENE))
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    trained = Controller(**{name: tensor.detach().numpy() for name, tensor in weights.items()})
    assert eldir.simulate_one(body, trained, SCENE).loss < losses[2] < losses[1] < losses[0]


def test_wrong_arguments_are_named() -> None:
    bodies, (brain,) = robots(FEW, 1, 6, SCENE)
    with raises(InputError, "input.wrong-value", "arrays of a controller", match="w1, b1, w2, b2"):
        rollouts.simulate(bodies, [{"w1": brain.w1}], SCENE)
    with raises(InputError, "input.wrong-number", "controllers"):
        rollouts.simulate(bodies, [], SCENE)
    with raises(InputError, "input.wrong-value", "Scene.window"):
        rollouts.simulate(bodies, [brain], SCENE.replace(window=5))
    weights = rollouts.parameters(brain)
    (by_b2,) = torch.autograd.grad(
        lively(rollouts.simulate_one(bodies[0], weights, SCENE)), weights["b2"], create_graph=True
    )
    with pytest.raises(RuntimeError, match="twice"):
        by_b2.sum().backward()
