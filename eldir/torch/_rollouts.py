"""Rollouts as an `autograd.Function` of PyTorch, on the adjoint that `eldir.jax` has too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from eldir.controller import Controller
from eldir.errors import MissingDependencyError
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene
from eldir.training.differentiable import FIELDS, Arrays, DifferentiableRollouts, RolloutArrays

try:
    import torch
except ModuleNotFoundError as error:
    raise MissingDependencyError(
        f"eldir.torch needs {error.name}, which is not installed here", remedy="pip install torch"
    ) from None


def simulate(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller | Arrays],
    scene: Scene,
    physics: Sequence[Physics | Arrays] | None = None,
) -> list[RolloutArrays]:
    """The rollouts of all robots, simulated together as by `eldir.simulate`: tensors on the CPU in the
    scene's precision, differentiable with respect to all tensors of controllers and physics.

    A controller may be a dictionary of its arrays "w1", "b1", "w2" and "b2", physics a dictionary of some of
    its fields; the others are the scene's and the body's. States of a robot that diverged are NaN, and so are
    its gradients, those that overflowed, and those of a function that has no derivative there.

    Raises `InputError` where an argument is invalid, `EldirError` where the step is too large for all robots.
    """
    robots = DifferentiableRollouts(tuple(morphologies), scene)
    weights, own = robots.arrays(controllers, physics)
    tensors = [v for given in (*weights, *own) for v in given.values()]
    flat = _Rollouts.apply(robots, weights, own, *tensors)
    return [RolloutArrays(*flat[k : k + 3]) for k in range(0, len(flat), 3)]


def simulate_one(
    morphology: Morphology,
    controller: Controller | Arrays,
    scene: Scene,
    physics: Physics | Arrays | None = None,
) -> RolloutArrays:
    """The rollout of one robot, as `simulate`."""
    return simulate([morphology], [controller], scene, None if physics is None else [physics])[0]


def parameters(record: Controller | Physics) -> dict[str, torch.Tensor]:
    """The arrays of a controller or of physics by name, as tensors in float64 that require gradients."""
    arrays = {k: np.array(getattr(record, k), np.float64) for k in FIELDS[type(record)]}
    return {k: torch.from_numpy(array).requires_grad_() for k, array in arrays.items()}


class _Rollouts(torch.autograd.Function):
    """From the arrays of all robots to positions, velocities and activations of one robot after the other."""

    @staticmethod
    def forward(
        ctx: Any, robots: DifferentiableRollouts, weights: list[Any], own: list[Any], *tensors: Any
    ) -> tuple[torch.Tensor, ...]:
        ctx.robots, ctx.numbers = robots, [_as_numbers(given) for given in (weights, own)]
        ctx.values = tensors
        ctx.set_materialize_grads(False)
        return tuple(torch.from_numpy(part) for found in robots.run(*ctx.numbers) for part in found)

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[untyped-decorator]
    def backward(ctx: Any, *pulled: torch.Tensor | None) -> tuple[Any, ...]:
        parts = [None if p is None else p.numpy() for p in pulled]
        derivatives = [RolloutArrays(*parts[k : k + 3]) for k in range(0, len(parts), 3)]
        found = ctx.robots.pull_back(*ctx.numbers, derivatives, lambda gradient, _: gradient)
        gradients = [gradient for arrays in found for one in arrays for gradient in one.values()]
        return None, None, None, *map(_as_tensor, gradients, ctx.values)


def _as_numbers(arrays: list[Arrays]) -> list[Arrays]:
    """The tensors' numbers, as arrays of NumPy."""
    return [
        {k: v.detach().cpu().numpy() if isinstance(v, torch.Tensor) else v for k, v in given.items()}
        for given in arrays
    ]


def _as_tensor(gradient: Any, value: Any) -> torch.Tensor | None:
    """As a tensor like the one that it belongs to; None for an array of NumPy."""
    if not isinstance(value, torch.Tensor):
        return None
    return torch.tensor(gradient, dtype=value.dtype, device=value.device)
