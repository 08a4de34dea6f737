"""Assigns the candidates in a picture to the markers, all at once, by the layout of the design.

An interpretation tree (Grimson and Lozano-Perez 1987): markers get candidates one after the other, and a
branch ends where two of them have a larger distance than the body allows.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.optimize import linear_sum_assignment

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir.errors import InputError

MAX_TILT = np.radians(60.0)
"""Largest tilt of a body against its design."""
_MAX_STRETCH, _SLACK = 1.5, 0.06
"""Largest distance of two masses, by their distance in the design, and in addition [m]: a hot motor is 1.5 to
2.1 times as long as a cold one, and a body unfolds."""
_MAX_BRANCHES = 4000
"""Maximum number of branches of the search; the branches that fit the layout best are kept."""
MAX_LAYOUT_RMS = 0.02
"""Largest RMS distance from the design without a note [m]: bodies sag, and one motor's stroke of 40 mm moves
one marker by as much relative to the others."""
_MAX_SAG = 0.01
"""The same for a single marker of a cold robot [m]: 24 mm of one marker of five. A foot of a good robot lies
15 mm from its design."""
_MIN_RMS_MARGIN = 0.005
"""A second assignment must fit worse by this RMS distance [m], and by a factor of two: one marker at a
distance of 12 mm, hardly more than a disc's diameter."""
MIN_SET_SIZE = 3
"""Fewer markers do not distinguish a second robot from other objects."""
SIMILAR_APPEARANCE = 0.2
"""Candidates whose differences are within this of each other look alike [rad of hue + residual of a disc]."""
AMBIGUITY_MARGIN = 0.012
"""A marker is ambiguous unless the second candidate is farther from the predicted position than the first by
this distance [m], and twice as far."""
_FORBIDDEN_COST = 1e6


@dataclass(frozen=True)
class Assignment:
    """A candidate for each marker."""

    candidates: IntArray
    """Index of each marker's candidate, -1 where it has none, shape (K,)."""
    rms: float
    """RMS distance of the candidates from the layout, up to shift and tilt [m]."""

    @property
    def markers(self) -> IntArray:
        """Indices of the markers that have a candidate."""
        return np.flatnonzero(self.candidates >= 0).astype(np.int32)


def max_distances(layout: FloatArray) -> FloatArray:
    """Largest distance of any two markers of a body with this layout (K, 2) [m], shape (K, K) [m]."""
    return _MAX_STRETCH * np.linalg.norm(layout[:, None] - layout, axis=-1) + _SLACK


def assign_candidates(
    allowed: BoolArray, positions: FloatArray, layout: FloatArray, max_missing: int = 0
) -> list[Assignment]:
    """All possible assignments of candidates at `positions` (N, 2) [m] to the markers of a `layout` (K, 2)
    [m]; the most complete first, and of these the best fit.

    `allowed` (K, N): which candidate may be which marker. At most `max_missing` markers have no candidate.
    """
    if not len(positions):
        return []
    limits = max_distances(layout)
    none = np.array([-1] if max_missing else [], dtype=np.int32)
    branches = np.zeros((1, 0), dtype=np.int32)
    for k, row in enumerate(allowed):
        options = np.concatenate([np.flatnonzero(row), none]).astype(np.int32)
        last = np.tile(options, len(branches))
        branches = np.repeat(branches, len(options), axis=0)
        both = (branches >= 0) & (last >= 0)[:, None]
        distances = np.linalg.norm(positions[branches] - positions[last][:, None], axis=-1)
        impossible = both & ((branches == last[:, None]) | (distances > limits[k, :k]))
        branches = np.column_stack([branches, last])[~impossible.any(axis=1)]
        missing = (branches < 0).sum(axis=1)
        branches = branches[missing <= max_missing]
        if len(branches) > _MAX_BRANCHES:
            residuals = layout_rms(layout[: k + 1], positions[branches], branches >= 0)
            branches = branches[np.argsort(residuals, kind="stable")[:_MAX_BRANCHES]]
    if not len(branches):
        return []
    residuals = layout_rms(layout, positions[branches], branches >= 0)
    order = np.lexsort((residuals, (branches < 0).sum(axis=1)))
    return [Assignment(branches[i], float(residuals[i])) for i in order.tolist()]


def layout_rms(layout: FloatArray, positions: FloatArray, present: BoolArray | None = None) -> FloatArray:
    """RMS distance [m] of points (..., K, 2) from a layout (..., K, 2) after the best shift and the best
    tilt, shape (...). Points that are not `present` (..., K) do not count."""
    weights = np.ones(positions.shape[:-1]) if present is None else present.astype(np.float64)
    count = np.maximum(weights.sum(axis=-1), 1)[..., None]
    weights = weights[..., None]
    a = layout - (weights * layout).sum(axis=-2, keepdims=True) / count[..., None]
    b = positions - (weights * positions).sum(axis=-2, keepdims=True) / count[..., None]
    a, b = weights * a, weights * b
    rotated = rotate(a, fit_tilt(a, b))
    return np.sqrt(((rotated - b) ** 2).sum(axis=(-2, -1)) / count[..., 0])


def fit_tilt(a: FloatArray, b: FloatArray) -> FloatArray:
    """The rotation [rad] of centred points `a` (..., K, 2) that fits `b` best, within the limit, shape (...,
    1)."""
    angle = np.arctan2((a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(-1), (a * b).sum((-2, -1)))
    return np.clip(angle, -MAX_TILT, MAX_TILT)[..., None]


def rotate(points: FloatArray, angle: FloatArray) -> FloatArray:
    """Points rotated about the origin by angles (...) [rad], shape (..., 2)."""
    c, s, x, y = np.cos(angle), np.sin(angle), points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def identify_markers(
    names: tuple[str, ...],
    allowed: BoolArray,
    differences: FloatArray,
    positions: FloatArray,
    layout: FloatArray | None,
) -> tuple[IntArray | None, list[str]]:
    """The candidate of each marker, shape (K,), and notes for the user; None without a possible assignment.

    `allowed` (K, N): which candidate at `positions` (N, 2) [m] may be which marker; `differences` (K, N):
    from its appearance. The `layout` (K, 2) [m] decides; without one, appearance does. Raises `InputError`
    where several assignments are equally good, or the markers are on the wrong masses.
    """
    if layout is None:
        return _assign_by_appearance(names, allowed, differences, positions), []
    assignments = assign_candidates(allowed, positions, layout)
    if not assignments:
        return None, []
    best, *others = assignments
    remaining = allowed.copy()
    remaining[:, best.candidates] = False
    if len(names) > MIN_SET_SIZE and remaining.any():  # an identical robot with one covered marker
        others += assign_candidates(remaining, positions, layout, 1)
    _require_unique(names, best, others, positions)
    return _check_fit(names, best, positions, layout)


def _require_unique(
    names: tuple[str, ...], best: Assignment, others: list[Assignment], positions: FloatArray
) -> None:
    """Raise `InputError` where another assignment is about as good as the best one."""
    limit = max(2 * best.rms, best.rms + _MIN_RMS_MARGIN)
    rival = next((a for a in others if a.rms < limit), None)
    if rival is None:
        return
    differ = [k for k in rival.markers if rival.candidates[k] != best.candidates[k]]
    x = positions[:, 0].round(2) + 0.0
    listed = ", ".join(
        f"{names[k]} at x = {x[best.candidates[k]]:.2f} m and at {x[rival.candidates[k]]:.2f} m"
        for k in differ[:2]
    )
    more = f"; the same of {', '.join(names[k] for k in differ[2:])}" if differ[2:] else ""
    raise InputError(
        "two sets of markers fit the design",
        code="marks.two-robots",
        expected="the markers of one robot in view",
        found=listed + more,
        remedy="cover the markers of the other robot, or move it out of the picture",
    )


def _check_fit(
    names: tuple[str, ...], best: Assignment, positions: FloatArray, layout: FloatArray
) -> tuple[IntArray | None, list[str]]:
    """The candidates and notes of `identify_markers`, by their distances from the layout."""
    assigned = positions[best.candidates]
    misplaced = find_misplaced_marker(names, assigned, layout, _MAX_SAG)
    if best.rms <= MAX_LAYOUT_RMS:
        return best.candidates, [f"{misplaced}: check it on the overlay."] if misplaced else []
    _require_correct_masses(names, assigned, layout, best.rms)
    if misplaced:
        return None, [misplaced]
    return best.candidates, [
        f"The markers lie {1e3 * best.rms:.0f} mm RMS from their places in the design (usual: up to "
        f"{1e3 * MAX_LAYOUT_RMS:.0f} mm): check on the overlay that each has its right name."
    ]


def _assign_by_appearance(
    names: tuple[str, ...], allowed: BoolArray, differences: FloatArray, positions: FloatArray
) -> IntArray | None:
    """The candidates with the most similar appearance, shape (K,); None where there are too few."""
    if len(positions) < len(names):
        return None
    rows, assigned = linear_sum_assignment(np.where(allowed, differences, _FORBIDDEN_COST))
    if not allowed[rows, assigned].all():
        return None
    near = allowed & (differences < differences[rows, assigned][:, None] + SIMILAR_APPEARANCE)
    near[:, assigned] = False
    if near.any():
        k = int(np.flatnonzero(near.any(axis=1))[0])
        x = sorted([*positions[[assigned[k]], 0].round(2) + 0.0, *positions[near[k], 0].round(2) + 0.0])
        raise InputError(
            "more candidates than markers",
            code="marks.too-many",
            expected=f"one marker that looks like {names[k]}",
            found="at x = " + " and ".join(f"{v:.2f} m" for v in x),
            remedy="give the design (--design), whose layout distinguishes them, or cover the others",
        )
    return np.asarray(assigned, np.int32)


def find_misplaced_marker(
    names: tuple[str, ...], positions: FloatArray, layout: FloatArray, min_rms: float = MAX_LAYOUT_RMS
) -> str:
    """A note on the single marker that is far from its place in the layout (K, 2) [m] while all others are
    near theirs; empty without one, or where all `positions` (K, 2) [m] fit to `min_rms` [m] RMS.

    Such a marker is covered, and a lookalike is in view; or it is glued to another mass.
    """
    rms = float(layout_rms(layout, positions))
    if len(names) <= MIN_SET_SIZE or rms < min_rms:
        return ""
    without = ~np.eye(len(names), dtype=bool)
    residuals = layout_rms(layout, np.broadcast_to(positions, (len(names), *positions.shape)), without)
    k = int(residuals.argmin())
    if residuals[k] > min(MAX_LAYOUT_RMS / 2, rms / 3):
        return ""
    x, y = positions[k].round(2) + 0.0
    others = ", ".join(n for n in names if n != names[k])
    return f"{names[k]} at ({x:.2f}, {y:.2f}) m is not at its place in the design, but {others} are"


def _require_correct_masses(
    names: tuple[str, ...], positions: FloatArray, layout: FloatArray, rms: float
) -> None:
    """Raise `InputError` if the markers with other names would fit the design much better.

    A body that sags or has folded does not match the design either, but other names do not fit better.
    """
    orders = np.array(list(permutations(range(len(names)))))
    errors = layout_rms(layout[orders], positions)
    best = int(errors.argmin())
    if errors[best] < rms / 2:
        swapped = ", ".join(
            f"{names[to]} where {name} should be"
            for name, to in zip(names, np.argsort(orders[best]), strict=True)
            if names[to] != name
        )
        raise InputError(
            "the markers are not at their places in the design",
            code="marks.elsewhere",
            expected=f"every marker near its place, within {1e3 * MAX_LAYOUT_RMS:.0f} mm",
            found=f"probably {swapped}",
            remedy="check which marker is glued to which mass, and that this is the robot's design",
        )


def predict_positions(known: FloatArray, offsets: FloatArray) -> FloatArray:
    """Positions of a body's markers (K, 2) [m], from those that are `known` (N, 2) [m] and from earlier
    `offsets` of all markers from them (K, N, 2) [m]: the body has shifted and tilted since."""
    middle, centre = known.mean(axis=0), offsets.mean(axis=1)
    tilt = fit_tilt(centre[:, None] - offsets, known - middle)
    return middle + rotate(centre, tilt[:, 0])


def assign_nearest(
    allowed: BoolArray, positions: FloatArray, predicted: FloatArray, reach: FloatArray
) -> IntArray:
    """For each marker the candidate nearest to its `predicted` position (K, 2) [m] within `reach` (K,) [m];
    -1 without one, or where another candidate is about as near."""
    distances = np.linalg.norm(positions - predicted[:, None], axis=-1)
    costs = np.where(allowed & (distances < reach[:, None]), distances, _FORBIDDEN_COST)
    assigned = np.full(len(costs), -1, np.int32)
    for k, n in zip(*linear_sum_assignment(costs), strict=True):
        second = np.delete(costs[k], n).min(initial=_FORBIDDEN_COST)
        if costs[k, n] < _FORBIDDEN_COST and second > max(2 * costs[k, n], costs[k, n] + AMBIGUITY_MARGIN):
            assigned[k] = n
    return assigned
