"""Where all masses of a robot are, from the few with marks. For viewers: only the marks are measured."""

from __future__ import annotations

import numpy as np

from eldir.core.records import BoolArray, FloatArray, IntArray

_LEAST = 2  # marks that fix a rigid motion
_STEPS = 12  # of Gauss and Newton; five are enough from where they begin
_MARK, _GUESS = 10.0, 0.01  # weight of a mark and of the guess, against 1 of a strip


def body_from_marks(
    rest: FloatArray, springs: IntArray, active: BoolArray, marked: IntArray, seen: FloatArray
) -> FloatArray | None:
    """Positions (M, 2) [m] of all masses of a body that was printed as `rest` (M, 2) [m], with the masses
    `marked` (K,) seen at `seen` (K, 2) [m], NaN where they are not; None with less than two marks.

    The strips, which are the `springs` (S, 2) that are not `active`, keep their lengths. The coils have any.
    """
    known = np.isfinite(seen).all(axis=1)
    if known.sum() < _LEAST:
        return None
    at, to = marked[known], seen[known]
    guess = _moved(rest, at, to)
    a, b = springs[~active].T
    lengths = np.linalg.norm(rest[b] - rest[a], axis=1)
    count, rows = len(rest), np.arange(len(a))
    fixed = np.full((count, 2), _GUESS**2)
    fixed[at] += _MARK**2
    places = guess
    for _ in range(_STEPS):
        apart = places[b] - places[a]
        now = np.linalg.norm(apart, axis=1)
        direction = apart / np.maximum(now, 1e-9)[:, None]
        jacobian = np.zeros((len(a), count, 2))
        jacobian[rows, b], jacobian[rows, a] = direction, -direction
        flat = jacobian.reshape(len(a), 2 * count)  # also where no spring is a strip
        pull = _GUESS**2 * (guess - places)
        pull[at] += _MARK**2 * (to - places[at])
        slope = flat.T @ (lengths - now) + pull.ravel()
        step = np.linalg.solve(flat.T @ flat + np.diag(fixed.ravel()), slope)
        places = places + step.reshape(-1, 2)
    return places


def _moved(rest: FloatArray, at: IntArray, to: FloatArray) -> FloatArray:
    """The body moved as a rigid one; what the marks differ from that is shared by the masses around them, by
    the inverse square of the distance."""
    own = rest[at]
    middle_own, middle_to = own.mean(axis=0), to.mean(axis=0)
    u, _, v = np.linalg.svd((own - middle_own).T @ (to - middle_to))
    turn = u @ np.diag([1.0, np.linalg.det(u @ v)]) @ v
    moved = (rest - middle_own) @ turn + middle_to
    apart = ((rest[:, None] - own[None]) ** 2).sum(axis=2)
    weights = 1.0 / np.maximum(apart, 1e-12)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(moved + weights @ (to - moved[at]))


def hub_angles(rest: FloatArray, springs: IntArray, positions: FloatArray) -> FloatArray:
    """By how much each hub has turned, counter-clockwise [rad], shape (M,): the mean turn of the springs
    (S, 2) at it, since their sockets hold them."""
    a, b = springs.T
    before, now = rest[b] - rest[a], positions[b] - positions[a]
    sine = before[:, 0] * now[:, 1] - before[:, 1] * now[:, 0]
    cosine = (before * now).sum(axis=1)
    turned = np.zeros((len(rest), 2))
    for end in (0, 1):
        np.add.at(turned, springs[:, end], np.column_stack([cosine, sine]))
    return np.arctan2(turned[:, 1], turned[:, 0])
