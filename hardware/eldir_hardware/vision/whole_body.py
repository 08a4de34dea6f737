"""Where all masses of a robot are, from the few with markers. For viewers: only the markers are measured."""

from __future__ import annotations

import numpy as np

from eldir.core.records import BoolArray, FloatArray, IntArray

_MIN_MARKERS = 2  # markers that fix a rigid motion
_ITERATIONS = 12  # of Gauss and Newton; five are enough from where they begin
_MARKER_WEIGHT, _GUESS_WEIGHT = 10.0, 0.01  # weight of a marker and of the guess, against 1 of a strip


def estimate_body(
    rest: FloatArray, springs: IntArray, active: BoolArray, masses: IntArray, positions: FloatArray
) -> FloatArray | None:
    """Positions (M, 2) [m] of all masses of a body that was printed as `rest` (M, 2) [m], with markers on
    the `masses` (K,) at `positions` (K, 2) [m], NaN where not visible; None with less than two markers.

    The strips, which are the `springs` (S, 2) that are not `active`, keep their lengths; the coils do not.
    """
    known = np.isfinite(positions).all(axis=1)
    if known.sum() < _MIN_MARKERS:
        return None
    at, to = masses[known], positions[known]
    guess = _rigid_guess(rest, at, to)
    a, b = springs[~active].T
    lengths = np.linalg.norm(rest[b] - rest[a], axis=1)
    count, rows = len(rest), np.arange(len(a))
    fixed = np.full((count, 2), _GUESS_WEIGHT**2)
    fixed[at] += _MARKER_WEIGHT**2
    estimate = guess
    for _ in range(_ITERATIONS):
        differences = estimate[b] - estimate[a]
        now = np.linalg.norm(differences, axis=1)
        direction = differences / np.maximum(now, 1e-9)[:, None]
        jacobian = np.zeros((len(a), count, 2))
        jacobian[rows, b], jacobian[rows, a] = direction, -direction
        flat = jacobian.reshape(len(a), 2 * count)  # also without strips
        gradient = _GUESS_WEIGHT**2 * (guess - estimate)
        gradient[at] += _MARKER_WEIGHT**2 * (to - estimate[at])
        total = flat.T @ (lengths - now) + gradient.ravel()
        step = np.linalg.solve(flat.T @ flat + np.diag(fixed.ravel()), total)
        estimate = estimate + step.reshape(-1, 2)
    return estimate


def _rigid_guess(rest: FloatArray, at: IntArray, to: FloatArray) -> FloatArray:
    """The body after a rigid motion. The residuals of the markers are shared by the masses around them, by
    the inverse square of the distance."""
    own = rest[at]
    middle_own, middle_to = own.mean(axis=0), to.mean(axis=0)
    u, _, v = np.linalg.svd((own - middle_own).T @ (to - middle_to))
    rotation = u @ np.diag([1.0, np.linalg.det(u @ v)]) @ v
    moved = (rest - middle_own) @ rotation + middle_to
    differences = ((rest[:, None] - own[None]) ** 2).sum(axis=2)
    weights = 1.0 / np.maximum(differences, 1e-12)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(moved + weights @ (to - moved[at]))


def estimate_hub_angles(rest: FloatArray, springs: IntArray, positions: FloatArray) -> FloatArray:
    """Rotation of each hub, counter-clockwise [rad], shape (M,): the mean rotation of the springs (S, 2) in
    its sockets."""
    a, b = springs.T
    before, now = rest[b] - rest[a], positions[b] - positions[a]
    sine = before[:, 0] * now[:, 1] - before[:, 1] * now[:, 0]
    cosine = (before * now).sum(axis=1)
    rotation_vectors = np.zeros((len(rest), 2))
    for end in (0, 1):
        np.add.at(rotation_vectors, springs[:, end], np.column_stack([cosine, sine]))
    return np.arctan2(rotation_vectors[:, 1], rotation_vectors[:, 0])
