"""The two discs of a hub as a rigid pair, joined by a connector that yields, or apart; their inverse masses.

The joints of a hub's body are x, y, z, yaw, roll and turn, as in `biplane_mjcf`. With a connector that yields
the back disc has three more, relative to the front one: x, z and turn. Discs without a connector have six
each.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from eldir.core.records import FloatArray
from eldir.parameters.wiring import FACES, Face
from eldir_cad.multibody.hubs import Inertia

Joining = Literal["rigid", "yielding", "apart"]
_RELATIVE = np.array([[1.0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, 0, 0, -1, 0]]).T
"""Motion of the back disc by its joints x, z and turn: velocity and rate of rotation, shape (6, 3)."""


@dataclass(frozen=True, eq=False)
class DiscPair:
    """The discs of a hub, each with half of the connector."""

    front: Inertia
    back: Inertia
    joining: Joining

    @property
    def whole(self) -> Inertia:
        """Both discs as one body."""
        return self.front + self.back

    def inverse_mass(self, face: Face, at: FloatArray, direction: FloatArray) -> float:
        """Acceleration along a unit vector by a unit force along it, at a point of a disc [1/kg]; connectors
        that yield exert no force. `at` [m] from the hub's centre, shape (3,); `direction`: shape (3,)."""
        moved = self._motions[FACES.index(face)].T @ np.concatenate([direction, np.cross(at, direction)])
        return float(moved @ self._inverse @ moved)

    @property
    def joint_inverse_masses(self) -> FloatArray:
        """Acceleration of each joint by a unit force or moment on it [1/kg, 1/(kg m2)], in the order of the
        joints."""
        return np.asarray(np.diag(self._inverse))

    @cached_property
    def _motions(self) -> tuple[FloatArray, FloatArray]:
        """Motion of front and back disc by each joint, shape (6, J) each."""
        one, none = np.eye(6), np.zeros((6, 6))
        if self.joining == "apart":
            return np.hstack([one, none]), np.hstack([none, one])
        if self.joining == "yielding":
            return np.hstack([one, np.zeros((6, 3))]), np.hstack([one, _RELATIVE])
        return one, one

    @cached_property
    def _inverse(self) -> FloatArray:
        """Inverse of the hub's mass matrix in its joints, shape (J, J)."""
        pairs = zip(self._motions, (self.front, self.back), strict=True)
        return np.linalg.inv(sum((m.T @ _spatial(one) @ m for m, one in pairs), np.zeros(())))


def pair_discs(front: Inertia, back: Inertia, connector: Inertia | None) -> DiscPair:
    """Two discs, each with half of the rigid connector between them, where there is one."""
    if connector is None:
        return DiscPair(front, back, "apart")
    reach = float(back.centre[1] - front.centre[1]) / 4  # of a half's centre from the middle
    half = connector.mass / 2
    own = connector.tensor / 2 - half * reach**2 * np.diag([1.0, 0.0, 1.0])
    across = np.array([0.0, reach, 0.0])
    halves = [Inertia(half, connector.centre + sign * across, own) for sign in (-1, 1)]
    return DiscPair(front + halves[0], back + halves[1], "rigid")


def _spatial(inertia: Inertia) -> FloatArray:
    """Inertia for velocity and rate of rotation at the hub's centre, shape (6, 6)."""
    x, y, z = inertia.centre
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    mass = inertia.mass * np.eye(3)
    return np.block(
        [[mass, -inertia.mass * arm], [inertia.mass * arm, inertia.tensor - inertia.mass * arm @ arm]]
    )
