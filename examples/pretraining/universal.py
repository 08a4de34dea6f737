"""One controller for all bodies: weights that belong to places in a body, not to a robot.

Each mass and each motor of a body has features: where it stands in the body (cosines of its place between
rear and front and between ground and top), whether it lies at the edge, whether it is a foot, and for
motors the direction of the spring. A robot's weights are these features times weights that all robots share.

So the engine simulates and differentiates robots with controllers of their own, as always. Because the
robot's weights are linear in the shared ones, the gradient of these is the features, transposed, times the
gradient of the robot's controller.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

import eldir
from eldir.controller import CPGS, HIDDEN
from eldir.lattice import CLEARANCE, HALF_SIDE

COSINES = [(i, j) for i in range(4) for j in range(3)]  # half waves along the body and upwards
MASS_FEATURES = len(COSINES) + 8
MOTOR_FEATURES = 3 * MASS_FEATURES


@dataclass(frozen=True)
class UniversalController:
    """Weights that all robots share; linear, so also a gradient with respect to them."""

    waves: np.ndarray
    """From the central pattern generators to the hidden layer, shape (32, 10)."""
    hidden: np.ndarray
    """Biases of the hidden layer, shape (32,)."""
    sense: np.ndarray
    """For each feature of a mass, weights of its dx, dy, vx, vy, shape (20, 32, 4)."""
    act: np.ndarray
    """For each feature of a motor, weights of its output, shape (60, 32)."""
    bias: np.ndarray
    """For each feature of a motor, the bias of its output, shape (60,)."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> UniversalController:
        """Random waves and outputs, and senses of zero."""
        waves = rng.normal(0, 0.4, (HIDDEN, CPGS))
        act = rng.normal(0, 1 / np.sqrt(HIDDEN), (MOTOR_FEATURES, HIDDEN))
        sense = np.zeros((MASS_FEATURES, HIDDEN, 4))
        return cls(waves, np.zeros(HIDDEN), sense, act, np.zeros(MOTOR_FEATURES))

    @property
    def flat(self) -> np.ndarray:
        """All weights in one row."""
        return np.concatenate([getattr(self, f.name).ravel() for f in fields(self)])

    def shaped(self, values: np.ndarray) -> UniversalController:
        """The same with its weights in one row as in `flat`."""
        arrays = [getattr(self, f.name) for f in fields(self)]
        parts = np.split(values, np.cumsum([a.size for a in arrays])[:-1])
        return UniversalController(*(p.reshape(a.shape) for p, a in zip(parts, arrays, strict=True)))

    def controller(self, body: eldir.Morphology) -> eldir.Controller:
        """The controller of a robot with this body."""
        masses, motors = features(body)
        sense = np.einsum("mf,fhk->hmk", masses, self.sense).reshape(HIDDEN, -1)
        w1 = np.concatenate([self.waves, sense], axis=1)
        return eldir.Controller(w1, self.hidden, motors @ self.act, motors @ self.bias)

    def gradient(self, body: eldir.Morphology, g: eldir.Controller) -> UniversalController:
        """The gradient of a robot's loss, from the gradient with respect to the robot's controller."""
        masses, motors = features(body)
        sense = np.einsum("mf,hmk->fhk", masses, g.w1[:, CPGS:].reshape(HIDDEN, len(masses), 4))
        return UniversalController(g.w1[:, :CPGS], g.b1, sense, motors.T @ g.w2, motors.T @ g.b2)


def features(body: eldir.Morphology) -> tuple[np.ndarray, np.ndarray]:
    """Features of the masses, shape (M, 20), and of the motors, shape (A, 60)."""
    x, y = body.positions.T
    springs = np.bincount(body.springs.ravel(), minlength=len(x))
    edge, foot = (springs < 6).astype(float), (y < y.min() + HALF_SIDE / 2).astype(float)
    hubs = body.motor_hubs
    masses = _place_features(body, body.positions, edge, foot)
    middles = (body.positions[hubs].mean(axis=1), edge[hubs].mean(axis=1), foot[hubs].mean(axis=1))
    rise = np.rint((y[hubs[:, 1]] - y[hubs[:, 0]]) / (np.sqrt(3) * HALF_SIDE)).astype(int)
    direction = np.eye(3)[rise + 1]  # falling, level or rising towards the front
    motors = np.einsum("ad,af->adf", direction, _place_features(body, *middles))
    return masses, motors.reshape(len(hubs), MOTOR_FEATURES)


def _place_features(
    body: eldir.Morphology, places: np.ndarray, edge: np.ndarray, foot: np.ndarray
) -> np.ndarray:
    """Features of places [m] in a body, shape (n, 20). The first four cosines again for edges and feet."""
    size = np.ptp(body.positions, axis=0)
    along, up = ((places - CLEARANCE) / np.maximum(size, HALF_SIDE)).T
    waves = np.stack([np.cos(np.pi * i * along) * np.cos(np.pi * j * up) for i, j in COSINES], axis=1)
    return np.concatenate([waves, waves[:, :4] * edge[:, None], waves[:, :4] * foot[:, None]], axis=1)
