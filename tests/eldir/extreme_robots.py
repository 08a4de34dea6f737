"""Robots of one, few or many springs, whose largest stable steps differ most."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eldir.controller import Controller
from eldir.engine.validity import OK
from eldir.lattice import Lattice
from eldir.morphology import Morphology
from eldir.rollout import simulate
from eldir.scene import SOFTENING, Scene
from tests.eldir.engine.random_robots import one, triangles_at


def extreme(name: str) -> Morphology:
    """Bodies at the edge of what there is."""
    wide, cells = Lattice(), np.zeros((13, 22), bool)
    if name in ("beam", "tower"):
        cells[(0, slice(None)) if name == "beam" else (slice(None), 5)] = True
        body = one(cells, wide)
    elif name == "lattice":
        body = one(np.ones((13, 22), bool), wide)
    elif name == "triangle":
        body = one(triangles_at((0, 1)))
    elif name == "hinge":
        body = one(triangles_at((0, 1), (1, 1)))
    else:
        body = one(triangles_at((0, 1), (0, 2), (0, 3), (1, 3)))
    if name in ("passive", "all active"):
        body = replace(body, active=np.full(len(body.springs), name == "all active"))
    if name == "coincident":
        x = body.positions.copy()
        x[1] = x[0]
        body = replace(body, positions=x)
    return body


def silent(body: Morphology) -> Controller:
    return Controller(
        np.zeros((32, 10 + 4 * len(body.positions))),
        np.zeros(32),
        np.zeros((body.motors, 32)),
        np.zeros(body.motors),
    )


def hovering(body: Morphology) -> Morphology:
    """Unstressed and shaken by 1e-7 m."""
    a, b = body.springs.T
    lengths = np.linalg.norm(body.positions[a] - body.positions[b], axis=1) + SOFTENING
    shaken = body.positions + 1e-7 * np.random.default_rng(0).standard_normal(body.positions.shape)
    return replace(body, positions=shaken + np.array([0, 5]), rest_lengths=lengths)


def grows(body: Morphology, scene: Scene) -> bool:
    """Whether what was shaken by 1e-7 m shakes more after some seconds of weightlessness."""
    (rollout,) = simulate([body], [silent(body)], scene)
    return rollout.status != OK or bool(np.abs(rollout.positions[-1] - rollout.positions[0]).max() > 1e-3)
