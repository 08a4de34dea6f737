"""Which candidates in a picture are the markers: all markers are assigned at once, by the design's layout.

An interpretation tree (Grimson and Lozano-Perez 1987): markers get candidates one after the other, and a
branch ends where two of them are farther apart than the body can hold them.
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
"""Two masses are at most this factor farther apart than in the design, and this distance [m]: a hot motor is
1.5 to 2.1 times as long as a cold one, and a body unfolds."""
_MAX_BRANCHES = 4000
"""Of more branches, those that fit the layout best are kept."""
LAYOUT_LIMIT = 0.02
"""RMS distance from the design that needs no note [m]: bodies sag, and one motor's stroke of 40 mm moves one
marker by so much against the others."""
_SAG = 0.01
"""The same for a single marker before anything heats [m]: 24 mm of one marker of five. A foot of a sound
robot lies 15 mm from its design."""
_CLEAR = 0.005
"""A second assignment must fit worse by this RMS distance [m], and by a factor of two: one marker that is 12
mm off, hardly more than a disc is wide."""
_MIN_SET = 3
"""Fewer markers of a second robot do not tell it from other things about."""
SIMILAR = 0.2
"""Candidates that differ less from each other look alike [rad of hue, and residual of a disc]."""
_NEVER = 1e6


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
    allowed: BoolArray, places: FloatArray, layout: FloatArray, max_missing: int = 0
) -> list[Assignment]:
    """All assignments of candidates at `places` (N, 2) [m] to the markers of a `layout` (K, 2) [m] that a
    body can have; the most complete first, and of these the best fit.

    `allowed` (K, N): which candidates look like which marker. At most `max_missing` markers stay without one.
    """
    farthest = max_distances(layout)
    none = np.array([-1] if max_missing else [], dtype=np.int32)
    branches = np.zeros((1, 0), dtype=np.int32)
    for k, row in enumerate(allowed):
        options = np.concatenate([np.flatnonzero(row), none]).astype(np.int32)
        last = np.tile(options, len(branches))
        branches = np.repeat(branches, len(options), axis=0)
        both = (branches >= 0) & (last >= 0)[:, None]
        apart = np.linalg.norm(places[branches] - places[last][:, None], axis=-1)
        wrong = both & ((branches == last[:, None]) | (apart > farthest[k, :k]))
        branches = np.column_stack([branches, last])[~wrong.any(axis=1)]
        missing = (branches < 0).sum(axis=1)
        branches = branches[missing <= max_missing]
        if len(branches) > _MAX_BRANCHES:
            residuals = layout_rms(layout[: k + 1], places[branches], branches >= 0)
            branches = branches[np.argsort(residuals, kind="stable")[:_MAX_BRANCHES]]
    if not len(branches):
        return []
    residuals = layout_rms(layout, places[branches], branches >= 0)
    order = np.lexsort((residuals, (branches < 0).sum(axis=1)))
    return [Assignment(branches[i], float(residuals[i])) for i in order.tolist()]


def layout_rms(layout: FloatArray, places: FloatArray, present: BoolArray | None = None) -> FloatArray:
    """RMS distance [m] of points (..., K, 2) from a layout (..., K, 2) after the best shift and the best
    tilt, shape (...). Points that are not `present` (..., K) do not count."""
    weights = np.ones(places.shape[:-1]) if present is None else present.astype(np.float64)
    count = np.maximum(weights.sum(axis=-1), 1)[..., None]
    weights = weights[..., None]
    a = layout - (weights * layout).sum(axis=-2, keepdims=True) / count[..., None]
    b = places - (weights * places).sum(axis=-2, keepdims=True) / count[..., None]
    a, b = weights * a, weights * b
    turned = turn(a, fit_tilt(a, b))
    return np.sqrt(((turned - b) ** 2).sum(axis=(-2, -1)) / count[..., 0])


def fit_tilt(a: FloatArray, b: FloatArray) -> FloatArray:
    """The tilt [rad] that brings centred points `a` (..., K, 2) nearest to `b`, shape (..., 1)."""
    angle = np.arctan2((a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(-1), (a * b).sum((-2, -1)))
    return np.clip(angle, -MAX_TILT, MAX_TILT)[..., None]


def turn(points: FloatArray, angle: FloatArray) -> FloatArray:
    """Points (..., 2) turned about the origin by angles (...) [rad]."""
    c, s, x, y = np.cos(angle), np.sin(angle), points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def identify_markers(
    names: tuple[str, ...],
    allowed: BoolArray,
    differences: FloatArray,
    places: FloatArray,
    layout: FloatArray | None,
) -> tuple[IntArray | None, list[str]]:
    """The candidate of each marker (K,), None where no body can have the candidates, and notes for the user.

    `allowed` (K, N): which candidates at `places` (N, 2) [m] look like which marker; `differences` (K, N):
    how much they differ from it. The `layout` (K, 2) [m] decides; without one, appearance does.
    Raises `InputError` where several candidates are equally good, or the markers are on the wrong masses.
    """
    if layout is None:
        return _most_similar(names, allowed, differences, places), []
    found = assign_candidates(allowed, places, layout)
    if not found:
        return None, []
    best = found[0]
    rest = allowed.copy()
    rest[:, best.candidates] = False
    others = found[1:]
    if len(names) > _MIN_SET and rest.any():  # a robot alike of which one marker is covered
        others = [*others, *assign_candidates(rest, places, layout, 1)]
    limit = max(2 * best.rms, best.rms + _CLEAR)
    rival = next((a for a in others if a.rms < limit), None)
    if rival is not None:
        differ = [k for k in rival.markers if rival.candidates[k] != best.candidates[k]]
        x = places[:, 0].round(2) + 0.0
        shown = ", ".join(
            f"{names[k]} at x = {x[best.candidates[k]]:.2f} m and at {x[rival.candidates[k]]:.2f} m"
            for k in differ[:2]
        )
        raise InputError(
            "two sets of markers fit the design",
            code="marks.two-robots",
            expected="the markers of one robot in view",
            found=shown + (f"; the same of {', '.join(names[k] for k in differ[2:])}" if differ[2:] else ""),
            remedy="cover the markers of the other robot, or move it out of the picture",
        )
    notes = []
    stranger = find_stranger(names, places[best.candidates], layout, _SAG)
    if stranger and best.rms <= LAYOUT_LIMIT:
        notes.append(f"{stranger}: check it on the overlay.")
    if best.rms > LAYOUT_LIMIT:
        _require_names(names, places[best.candidates], layout, best.rms)
        if stranger:
            return None, [stranger]
        notes.append(
            f"The markers lie {1e3 * best.rms:.0f} mm RMS from their places in the design (usual: up to "
            f"{1e3 * LAYOUT_LIMIT:.0f} mm): check on the overlay that each has its right name."
        )
    return best.candidates, notes


def _most_similar(
    names: tuple[str, ...], allowed: BoolArray, differences: FloatArray, places: FloatArray
) -> IntArray | None:
    """The candidates that look most like the markers; None where there are too few."""
    if len(places) < len(names):
        return None
    rows, chosen = linear_sum_assignment(np.where(allowed, differences, _NEVER))
    if not allowed[rows, chosen].all():
        return None
    near = allowed & (differences < differences[rows, chosen][:, None] + SIMILAR)
    near[:, chosen] = False
    if near.any():
        k = int(np.flatnonzero(near.any(axis=1))[0])
        x = sorted([*places[[chosen[k]], 0].round(2) + 0.0, *places[near[k], 0].round(2) + 0.0])
        raise InputError(
            "more candidates than markers",
            code="marks.too-many",
            expected=f"one marker that looks like {names[k]}",
            found="at x = " + " and ".join(f"{v:.2f} m" for v in x),
            remedy="give the design, whose layout tells them apart (--design), or cover the others",
        )
    return np.asarray(chosen, np.int32)


def find_stranger(
    names: tuple[str, ...], places: FloatArray, layout: FloatArray, min_rms: float = LAYOUT_LIMIT
) -> str:
    """Which single marker is far from its place in the layout (K, 2) [m] while all others are near theirs, as
    a note; empty where none is, or where all `places` (K, 2) [m] fit to `min_rms` [m] RMS.

    Then it is covered, and something else that looks like it is in view; or it is glued to another mass.
    """
    rms = float(layout_rms(layout, places))
    if len(names) <= _MIN_SET or rms < min_rms:
        return ""
    without = ~np.eye(len(names), dtype=bool)
    residuals = layout_rms(layout, np.broadcast_to(places, (len(names), *places.shape)), without)
    k = int(residuals.argmin())
    if residuals[k] > min(LAYOUT_LIMIT / 2, rms / 3):
        return ""
    x, y = places[k].round(2) + 0.0
    others = ", ".join(n for n in names if n != names[k])
    return f"{names[k]} at ({x:.2f}, {y:.2f}) m is not at its place in the design, but {others} are"


def _require_names(names: tuple[str, ...], found: FloatArray, layout: FloatArray, rms: float) -> None:
    """Raise `InputError` if the markers with other names would fit the design much better.

    A body that sags or has folded does not match the design either, but other names do not fit better.
    """
    orders = np.array(list(permutations(range(len(names)))))
    off = layout_rms(layout[orders], found)
    best = int(off.argmin())
    if off[best] < rms / 2:
        seem = ", ".join(
            f"{names[to]} where {name} should be"
            for name, to in zip(names, np.argsort(orders[best]), strict=True)
            if names[to] != name
        )
        raise InputError(
            "the marks are not at their places in the design",
            code="marks.elsewhere",
            expected=f"every mark near its place, within {1e3 * LAYOUT_LIMIT:.0f} mm",
            found=f"probably {seem}",
            remedy="check which mark is glued to which mass, and that this is the robot's design",
        )
