"""The largest time step at which the simulation of a printed robot is stable.

Semi-implicit Euler with dashpots is stable while dt^2 K + 2 dt C < 4 M (Jury's criterion); the largest
eigenvalues of M^-1 K and M^-1 C are taken separately, which errs on the safe side.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eldir.core.records import FloatArray

if TYPE_CHECKING:
    from eldir.built.robot import PrintedRobot

STICKS = float(np.radians(0.5))
"""Angle by which a strip turns before the friction of its socket gives way [rad]."""
_DENSE = 64  # coordinates; for more, LAPACK starts threads, which take a tenth of a second on a busy machine
_SHARE = 0.1  # of a strip's bending energy that is counted twice, see stable_step_in_any_pose
_SPLITS = (0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
_TURNED = 0.5  # sine of the largest angle between a hub and a strip: 30 degrees


def stable_step(robot: PrintedRobot) -> float:
    """Largest stable step in the pose as assembled [s]."""
    if robot.joints == "hubs":
        return stable_step_in_any_pose(robot)
    a, b = robot.springs.T
    ends = _ends(robot)
    translations = ends / np.sqrt(robot.masses)
    along = robot.directions
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    stretch = _planar(translations, along)
    if robot.joints == "pins":
        return _step([(stretch, robot.stiffness)], [(stretch, robot.damping)])
    length = np.linalg.norm(robot.positions[a] - robot.positions[b], axis=1, keepdims=True)
    nowhere = np.zeros((len(a), len(robot.masses)))
    turn = _planar(translations, across / length)
    together = np.hstack([-2 * turn, np.abs(ends) / np.sqrt(robot.inertias)])
    apart = np.hstack([nowhere, nowhere, ends / np.sqrt(robot.inertias)])
    stretch, delay = np.hstack([stretch, nowhere]), robot.bending_delay
    bent: Terms = [(together, 3 * robot.bending), (apart, robot.bending)]
    return _step(
        [(stretch, robot.stiffness), *bent],
        [(stretch, robot.damping), *((rows, delay * k) for rows, k in bent)],
    )


def stable_step_in_any_pose(robot: PrintedRobot) -> float:
    """Largest stable step in any pose [s].

    `(u . (xa - xb))^2 <= |xa - xb|^2` for any unit vector u, so that no pose is stiffer than the body
    with all its springs along one line. Bending couples translation t = w . (xa - xb) / l and rotation p
    of a strip; (p - 2 t)^2 <= (1 + e) p^2 + (1 + 1/e) 4 t^2 separates them for any w. In the same
    way the motion of a hub's centre is separated from that of its hinges as it turns, for strips that turn by
    30 degrees at most; any e is right, and the best of some is taken.
    """
    ends = _ends(robot)
    line, turns = ends / np.sqrt(robot.masses), np.abs(ends) / np.sqrt(robot.inertias)
    across = 12 * robot.bending / robot.parameters.pitch**2 * (1 + 1 / _SHARE)
    delay = robot.bending_delay
    moving: Terms = [(line, robot.stiffness + across)]
    slowed: Terms = [(line, robot.damping + delay * across)]
    translating = _step(moving, slowed)
    if robot.joints == "pins":
        return translating
    turning: Terms = [
        (turns, 3 * (1 + _SHARE) * robot.bending),
        (ends / np.sqrt(robot.inertias), robot.bending),
    ]
    delayed = [(rows, delay * k) for rows, k in turning]
    if robot.joints == "clamped":
        return min(translating, _step(turning, delayed))
    arm = (robot.parameters.socket * _TURNED) ** 2
    held = (turns, np.full(len(ends), robot.parameters.socket_friction / STICKS))
    steps = []
    for more in _SPLITS:
        along = _step(
            [(line, (1 + more) * robot.stiffness + across)],
            [(line, (1 + more) * robot.damping + delay * across)],
        )
        around = _step(
            [*turning, held, (turns, (1 + 1 / more) * arm * robot.stiffness)],
            [*delayed, (turns, (1 + 1 / more) * arm * robot.damping)],
        )
        steps.append(min(along, around))
    return max(steps)


def _ends(robot: PrintedRobot) -> FloatArray:
    """Incidence matrix: 1 at the first and -1 at the second mass of every spring, shape (S, M)."""
    ends = np.zeros((len(robot.springs), len(robot.masses)))
    rows = np.arange(len(ends))
    ends[rows, robot.springs[:, 0]], ends[rows, robot.springs[:, 1]] = 1.0, -1.0
    return ends


def _planar(ends: FloatArray, along: FloatArray) -> FloatArray:
    """Relative displacement along a vector for each spring, as rows over all x, then all y."""
    return np.hstack([ends * along[:, :1], ends * along[:, 1:]])


Terms = list[tuple[FloatArray, FloatArray]]
"""Strains as rows over mass-scaled coordinates, and the stiffness or damping of each."""


def _step(stiffness: Terms, damping: Terms) -> float:
    k, c = _largest_eigenvalue(stiffness), _largest_eigenvalue(damping)
    return (-c + float(np.sqrt(c**2 + 4 * k))) / k


def _largest_eigenvalue(terms: Terms) -> float:
    scaled = np.vstack([rows * np.sqrt(weight)[:, None] for rows, weight in terms])
    n = scaled.shape[1]
    if n <= _DENSE:
        return float(np.linalg.eigvalsh(scaled.T @ scaled)[-1])
    if not scaled.any():
        return 0.0
    from scipy.sparse import linalg  # a fifth of a second, and only large robots need it

    square = linalg.LinearOperator((n, n), matvec=lambda v: scaled.T @ (scaled @ v), dtype=float)
    start = np.random.default_rng(0).standard_normal(n)
    return float(linalg.eigsh(square, 1, which="LA", v0=start, tol=1e-9, return_eigenvectors=False)[0])
