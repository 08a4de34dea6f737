"""Rollouts as a function with its adjoint, for frameworks that differentiate what stands around them.

`eldir.jax` and `eldir.torch` hand over arrays by name, and get the rollouts' arrays and, from the derivatives
with respect to these, the gradients with respect to the arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_count, require_known, require_value
from eldir.engine.pack import MotionCotangents
from eldir.engine.validity import OK
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.rollout import simulate
from eldir.scene import Scene
from eldir.training.gradients import motion_gradient

FIELDS = {kind: tuple(f.name for f in fields(kind)) for kind in (Controller, Physics)}
"""The names of each record's arrays."""
Arrays = Mapping[str, Any]
"""Arrays of NumPy, JAX or PyTorch by the name of a record's field."""


class RolloutArrays(NamedTuple):
    """The motion of one robot over T steps, in the scene's precision: arrays of JAX or tensors of PyTorch."""

    positions: Any
    """Positions of the masses [m], shape (T + 1, M, 2)."""
    velocities: Any
    """Velocities of the masses [m/s], shape (T + 1, M, 2)."""
    activations: Any
    """Activations of the active springs, from -1 to 1, shape (T, A)."""


@dataclass(frozen=True, eq=False)
class DifferentiableRollouts:
    """The rollouts of some robots as functions of the arrays of their controllers and of their physics."""

    morphologies: tuple[Morphology, ...]
    scene: Scene

    @property
    def real(self) -> type[np.float32] | type[np.float64]:
        """The type of all numbers of a rollout."""
        return np.float32 if self.scene.precision == "f32" else np.float64

    def arrays(
        self,
        controllers: Sequence[Controller | Arrays],
        physics: Sequence[Physics | Arrays] | None,
    ) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """The arrays by name of each controller and of each robot's physics. Raises `InputError` where there
        are too few or too many, or the scene cannot be differentiated."""
        self.scene.require_controller()
        require_value("Scene.window", self.scene.window is None, "None", self.scene.window)
        n = len(self.morphologies)
        require_count("controllers", len(controllers), n)
        require_count("physics", len(physics) if physics is not None else n, n)
        weights = [_arrays(Controller, c) for c in controllers]
        for given in weights:
            require_known("arrays of a controller", given, FIELDS[Controller])
            missing = [name for name in FIELDS[Controller] if name not in given]
            require_value("arrays of a controller", not missing, "w1, b1, w2, b2", ", ".join(given))
        own = [_arrays(Physics, p) for p in physics] if physics is not None else [{} for _ in range(n)]
        return weights, own

    def run(self, weights: Sequence[Arrays], own: Sequence[Arrays]) -> Iterator[RolloutArrays]:
        """The rollouts as arrays of NumPy in the scene's precision."""
        for r in simulate(self.morphologies, self._controllers(weights), self.scene, self._physics(own)):
            yield RolloutArrays(*(np.asarray(getattr(r, k), self.real) for k in RolloutArrays._fields))

    def pull_back(
        self,
        weights: Sequence[Arrays],
        own: Sequence[Arrays],
        derivatives: Sequence[RolloutArrays],
        convert: Callable[[Any, Any], Any],
    ) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """The gradients with respect to all arrays, from a function's derivatives with respect to the
        rollouts, of which None stands for zeros. `convert` makes the framework's array of a gradient and of
        the array that it belongs to. Gradients of robots that diverged are NaN: a zero would tell an
        optimiser of the sum that all is well."""
        cotangents = [self._cotangents(*pair) for pair in zip(self.morphologies, derivatives, strict=True)]
        found = motion_gradient(
            self.morphologies, self._controllers(weights), self.scene, self._physics(own), cotangents
        )
        of_weights, of_physics = (
            [
                {k: convert(_like(v, getattr(record, k), ok), v) for k, v in given.items()}
                for given, record, ok in zip(arrays, records, found.status == OK, strict=True)
            ]
            for arrays, records in ((weights, found.controllers), (own, found.physics))
        )
        return of_weights, of_physics

    def _controllers(self, weights: Sequence[Arrays]) -> list[Controller]:
        return [Controller(**{k: np.asarray(v, np.float64) for k, v in given.items()}) for given in weights]

    def _physics(self, own: Sequence[Arrays]) -> list[Physics]:
        return [
            Physics.of(body, self.scene).replace(**{k: number_or_array(v) for k, v in given.items()})
            for body, given in zip(self.morphologies, own, strict=True)
        ]

    def _cotangents(self, body: Morphology, derivatives: RolloutArrays) -> MotionCotangents:
        positions, *others = (None if d is None else np.asarray(d) for d in derivatives)
        if positions is None:
            positions = np.zeros((self.scene.steps + 1, *body.positions.shape))
        return MotionCotangents(positions, *others)


def number_or_array(value: Any) -> Any:
    """A float, or an array of NumPy in float64."""
    array = np.asarray(value, np.float64)
    return float(array) if array.ndim == 0 else array


def _arrays(kind: type[Any], given: Any) -> dict[str, Any]:
    """The fields of a record, or a dictionary as it is."""
    if isinstance(given, kind):
        return {name: getattr(given, name) for name in FIELDS[kind]}
    return dict(given)


def _like(value: Any, gradient: Any, ok: bool) -> Any:
    """A gradient of the same shape: one number stands for all springs or masses."""
    summed = np.sum(gradient) if np.ndim(value) == 0 else np.asarray(gradient)
    return summed if ok else np.full_like(summed, np.nan)
