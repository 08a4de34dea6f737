"""Controllers before they learn: random weights, each robot's from its own seed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_number, whole_number
from eldir.engine.threads import for_each
from eldir.morphology import Morphology
from eldir.scene import Scene

Key = tuple[int, ...]
"""Seed of the random initial weights of one robot."""


def initial_controllers(
    morphologies: Sequence[Morphology], scene: Scene, seed: int | Sequence[int]
) -> list[Controller]:
    """Random weights, each robot's drawn from its own seed."""
    n = len(morphologies)
    keys = keys_of(n, seed)
    require_number("seeds", len(keys), n)
    return list(InitialControllers(morphologies, scene, keys))


class InitialControllers(Sequence[Controller]):
    """`initial_of` each robot, made when it is read: those of thousands of robots need not exist together."""

    def __init__(self, morphologies: Sequence[Morphology], scene: Scene, origins: Sequence[Controller | Key]):
        self._morphologies, self._scene, self._origins = morphologies, scene, origins

    def __len__(self) -> int:
        return len(self._morphologies)

    def __getitem__(self, r: Any) -> Any:
        return initial_of(self._morphologies[r], self._scene, self._origins[r])

    def __iter__(self) -> Iterator[Controller]:
        return iter(for_each(self.__getitem__, len(self)))


def keys_of(n: int, seed: int | Sequence[int]) -> list[Key]:
    """The key of each robot: (seed, index), or the robot's own seed. Raises `InputError` for no seed."""
    if isinstance(seed, Sequence | np.ndarray):
        return [(whole_number("seed of a robot", own, 0),) for own in seed]
    common = whole_number("seed", seed, 0)
    return [(common, i) for i in range(n)]


def initial_of(body: Morphology, scene: Scene, origin: Controller | Key) -> Controller:
    """The given controller, or random weights from its key."""
    if isinstance(origin, Controller):
        return origin
    return Controller.random(
        len(body.positions),
        body.motors,
        np.random.default_rng(origin),
        released_springs=len(body.springs) if scene.weights == "released" else None,
    )
