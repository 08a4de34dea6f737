"""Tracks the markers of any kind: they are identified by their layout, tracked, and found again.

A kind of marker detects candidates in a picture. Which of them are the markers is decided here, by the
design, the plane of motion and the motion so far. The position of a marker that is partly covered or out of
the picture is NaN; nothing is interpolated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Generic, Protocol, TypeVar

import numpy as np

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.markers._assignment import (
    AMBIGUITY_MARGIN,
    MAX_LAYOUT_RMS,
    MIN_SET_SIZE,
    SIMILAR_APPEARANCE,
    assign_candidates,
    assign_nearest,
    find_misplaced_marker,
    identify_markers,
    max_distances,
    predict_positions,
)

_MAX_DEPTH = 0.005
"""How far below the ground a marker may appear [m]: reflections lie below."""
_MAX_JUMP = 0.03
"""Largest distance of a marker that is found again at once from its predicted position [m]."""
_RELATIVE_SPEED, _MAX_SHIFT = 0.1, 0.08
"""How fast that distance grows [m/s], and its maximum [m], while other markers of the body are visible: a
motor contracts by 40 mm at half that speed."""
_NEAR_RADIUS, _NEAR_GROWTH, _MAX_NEAR_RADIUS = 0.005, 0.02, 0.012
"""Distance from its predicted position at which a marker needs no confirmation by its motion [m], how fast it
grows [m/s], and its maximum [m]: a disc's width. Farther away, a candidate could be a lookalike."""
_MAX_COAST = 0.3
"""The predicted velocity of a marker that was lost for longer does not count [s]."""
_MIN_MOTION = 0.003
"""A candidate that has moved farther is a marker and no static lookalike [m]."""
_MAX_WALKING_SPEED = 0.05
"""Largest speed of a robot without a visible marker [m/s]."""
_SAME_PLACE_RADIUS = 0.004
"""A candidate within this distance of a known lookalike is that lookalike [m]."""
_MISSING_COST = 0.05
"""Cost of a missing marker, as a distance that it has moved [m]."""
_CHECK_INTERVAL, _MAX_SEARCH_INTERVAL = 1.0, 4.0
"""Time between two checks of the markers' layout, and the longest between two searches for other robots,
each of which costs as much as four usual frames [s]."""
_MAX_NOTES = 8
_MAX_LOOKALIKES = 200


class Detection(Protocol):
    """A candidate in a picture."""

    @property
    def centre(self) -> FloatArray:
        """Its centre [px], shape (2,)."""

    @property
    def size(self) -> float:
        """Its width [px]."""


D = TypeVar("D", bound=Detection)


class MarkerTracker(ABC, Generic[D]):
    """Tracks the markers of one kind in the pictures of one camera.

    A kind implements `_detect` and `_confirm`; the other hooks have defaults.
    """

    appearance: ClassVar[str]
    """What the markers look like, for messages."""
    is_coloured: ClassVar[bool] = False
    """Whether they are found by their colour."""
    relative_size_error: float = 0.0
    """Error of a marker's apparent size, relative to it."""

    def __init__(self, plane: Plane, names: tuple[str, ...], layout: FloatArray | None = None):
        """`layout` (K, 2) [m]: where the design has the markers `names`, up to shift and tilt."""
        self.plane = plane
        self.names = names
        self.sizes: FloatArray = np.full(len(names), np.nan)
        """Apparent size of each marker in the last frame, relative to its first size, shape (K,)."""
        self.undetected: tuple[str, ...] = names
        """Markers without a candidate in the last frame, until all markers are acquired."""
        self.notes: list[str] = []
        """Remarks for the user: on how the markers were found, or why they were not."""
        self.remedy = ""
        """Remedy where the notes explain why markers were not found."""
        self._layout = None if layout is None else np.asarray(layout, np.float64).reshape(len(names), 2)
        self._first_sizes: FloatArray | None = None
        # Of each when it was last visible [m].
        self._last_positions: FloatArray = np.full((len(names), 2), np.nan)
        self._last_times: FloatArray = np.zeros(len(names))  # of these positions [s]
        self._offsets: FloatArray = np.zeros((len(names), len(names), 2))  # of each from each other [m]
        self._max_distances: FloatArray = np.zeros((len(names), len(names)))
        # Of the design, or of the first frame [m].
        self._reference_layout: FloatArray = np.zeros((len(names), 2))
        self._next_layout_check = np.inf  # [s]
        self._next_search = np.inf  # [s]
        self._search_interval = _CHECK_INTERVAL / 2
        self._lookalikes: FloatArray = np.zeros((0, 2))  # positions of other objects [m]
        self._lost: BoolArray = np.zeros(len(names), bool)  # not visible in the last frame
        self._misplaced: set[str] = set()  # markers with a note
        # Positions of candidates that have not moved yet [m].
        self._unconfirmed: FloatArray = np.full((len(names), 2), np.nan)

    @property
    def acquired(self) -> bool:
        """Whether all markers have been identified together in a frame."""
        return self._first_sizes is not None

    def update(self, frame: Image, t: float) -> FloatArray:
        """Positions (K, 2) [m] of the markers in a frame (H, W, 3) BGR taken at t [s]; NaN where not visible.

        Raises `InputError` where the markers are ambiguous, or not at their places in the design.
        """
        self.plane.require_size(frame.shape[1], frame.shape[0])
        if self.acquired:
            detections = self._reject_stale(self._detect_nearby(frame, t), t)
            if None in detections:
                detections = self._recover(frame, detections, t)
        else:
            detections = [*self._acquire(frame, t)] or [None] * len(self.names)
        centres = np.array([(np.nan, np.nan) if d is None else d.centre for d in detections])
        positions = self._reject_impossible(self.plane.to_metres(centres))
        scales = self.plane.pixels_per_metre(positions)
        sizes = np.array([np.nan if d is None else d.size for d in detections]) / scales
        if self._first_sizes is None:
            if np.isnan(positions).any():
                return positions
            self._first_sizes = sizes
        visible = np.isfinite(positions[:, 0])
        self._lost = ~visible
        self.sizes = np.where(visible, sizes / self._first_sizes, np.nan)
        self._last_positions[visible], self._last_times[visible] = positions[visible], t
        self._unconfirmed[visible] = np.nan
        both = visible[:, None] & visible
        self._offsets[both] = (positions[:, None] - positions)[both]
        for k, detection in enumerate(detections):
            if detection is not None and visible[k]:
                self._update_track(k, detection, float(scales[k]), t)
        self._check_layout(positions, t)
        self._search_second_robot(frame, positions, t)
        return positions

    def _check_layout(self, positions: FloatArray, t: float) -> None:
        """From time to time, note a marker that does not fit the layout: the tracker may have locked on to
        another object."""
        if t < self._next_layout_check:
            return
        self._next_layout_check = t + _CHECK_INTERVAL
        visible = np.flatnonzero(np.isfinite(positions[:, 0]))
        names = tuple(self.names[k] for k in visible)
        misplaced = find_misplaced_marker(names, positions[visible], self._reference_layout[visible])
        name = misplaced.partition(" ")[0]
        if misplaced and name not in self._misplaced:
            self._misplaced.add(name)
            self.notes.append(f"At {t:.1f} s {misplaced}: check it on the overlay.")

    def _search_second_robot(self, frame: Image, positions: FloatArray, t: float) -> None:
        """From time to time, search the whole frame for a second robot."""
        if t < self._next_search or len(self.names) < MIN_SET_SIZE:
            return
        self._next_search = t + self._search_interval
        self._search_interval = min(2 * self._search_interval, _MAX_SEARCH_INTERVAL)
        detections, allowed, _ = self._detect(frame)
        candidates = self._to_positions(detections)
        self._remember_lookalikes(allowed, candidates, positions)
        self._note_second_robot(allowed, candidates, positions, t)

    def _note_second_robot(
        self, allowed: BoolArray, candidates: FloatArray, positions: FloatArray, t: float
    ) -> None:
        """Note a second set of markers among candidates (N, 2) [m], once; ours is at `positions` (K, 2)."""
        tracked = np.linalg.norm(candidates[:, None] - positions, axis=-1) < AMBIGUITY_MARGIN
        allowed = allowed & (candidates[:, 1] > -_MAX_DEPTH) & ~tracked.any(axis=1)
        max_missing = len(self.names) - max(MIN_SET_SIZE, len(self.names) - 2)
        sets = assign_candidates(allowed, candidates, self._reference_layout, max_missing)
        if sets and sets[0].rms < MAX_LAYOUT_RMS:
            self._next_search = np.inf
            k = int(sets[0].markers[0])
            x, y = candidates[sets[0].candidates[k]] + 0.0
            own_x, own_y = (positions if np.isfinite(positions[k, 0]) else self._last_positions)[k] + 0.0
            self.notes.append(
                f"At {t:.1f} s a second set of markers is in view, {self.names[k]} at ({x:.2f}, {y:.2f}) m; "
                f"the tracked one has it at ({own_x:.2f}, {own_y:.2f}) m: check on the overlay that the "
                "right robot is tracked."
            )

    def _remember_lookalikes(self, allowed: BoolArray, candidates: FloatArray, positions: FloatArray) -> None:
        """Remember candidates (N, 2) [m] that look like a marker (`allowed`, (K, N)) and are not one, since
        that marker is visible elsewhere, at `positions` (K, 2) [m]."""
        # NaN, of a marker that is not visible, is not far from anything.
        far = np.linalg.norm(candidates - positions[:, None], axis=-1) > AMBIGUITY_MARGIN
        new = (far | ~allowed).all(axis=0) & allowed.any(axis=0)
        known = [self._lookalikes, candidates[new & ~self._at_lookalikes(candidates)]]
        self._lookalikes = np.concatenate(known)[-_MAX_LOOKALIKES:]

    def _at_lookalikes(self, candidates: FloatArray) -> BoolArray:
        """Which candidates (N, 2) [m] are at the position of a known lookalike, shape (N,)."""
        distances = np.linalg.norm(candidates[:, None] - self._lookalikes, axis=-1)
        return np.asarray((distances < _SAME_PLACE_RADIUS).any(axis=1))

    @abstractmethod
    def _detect(self, frame: Image) -> tuple[list[D], BoolArray, FloatArray]:
        """N candidates in the whole frame, which of them may be which marker by its appearance, shape (K, N),
        and the difference from its printed appearance, shape (K, N)."""

    @abstractmethod
    def _confirm(self, frame: Image, k: int, candidate: D) -> D | None:
        """The candidate measured as marker k; None if it does not look like it."""

    def _detect_nearby(self, frame: Image, t: float) -> list[D | None]:
        """Markers detected near their predicted positions, without a search of the whole frame."""
        return [None] * len(self.names)

    def _reject_stale(self, detections: list[D | None], t: float) -> list[D | None]:
        """Detections without those of markers that had been lost and may be lookalikes."""
        if not self._lost.any():
            return detections
        positions = self.plane.to_metres(
            np.array([(np.nan, np.nan) if d is None else d.centre for d in detections])
        )
        stale = self._lost & ((t - self._last_times > _MAX_COAST) | self._at_lookalikes(positions))
        return [None if bad else d for d, bad in zip(detections, stale.tolist(), strict=True)]

    def _start_tracks(self, frame: Image, assigned: list[D], t: float) -> list[D]:
        """The assigned candidates, measured again as markers; empty where they are not good enough."""
        return assigned

    def _update_track(self, k: int, detection: D, scale: float, t: float) -> None:
        """Update the state of marker k, at a scale [px/m]."""

    def _acquire(self, frame: Image, t: float) -> Sequence[D]:
        """Identify the markers in the first frame that shows them all; empty before."""
        candidates, allowed, differences = self._detect(frame)
        positions = self._to_positions(candidates)
        self.notes = []
        above_ground = allowed & ~(positions[:, 1] < -_MAX_DEPTH)
        self.undetected = tuple(n for n, row in zip(self.names, above_ground, strict=True) if not row.any())
        if self.undetected:
            self._explain_undetected(tuple(n for n in self.undetected if allowed[self.names.index(n)].any()))
            return []
        assigned, notes = identify_markers(self.names, above_ground, differences, positions, self._layout)
        if assigned is None:
            self.notes = notes
            self.remedy = "uncover the markers, and check which is glued to which mass"
            return []
        detections = self._start_tracks(frame, [candidates[c] for c in assigned.tolist()], t)
        if not detections:
            return []
        others = np.ones(len(positions), bool)
        others[assigned] = False
        self._lookalikes = positions[others & allowed.any(axis=0)]
        limits = differences[np.arange(len(assigned)), assigned][:, None] + SIMILAR_APPEARANCE
        self.notes += notes + self._lookalike_note(above_ground & others & (differences < limits), positions)
        self._start_searches(allowed, positions, positions[assigned], t)
        return detections

    def _start_searches(
        self, allowed: BoolArray, candidates: FloatArray, positions: FloatArray, t: float
    ) -> None:
        """Start to check the layout of the markers, identified at `positions`, and to search other robots."""
        self._reference_layout = positions if self._layout is None else self._layout
        self._max_distances = max_distances(self._reference_layout)
        self._next_layout_check = t + _CHECK_INTERVAL
        # Soon: our robot may be covered in this frame, and another one visible.
        self._next_search = t + self._search_interval
        if len(self.names) >= MIN_SET_SIZE:
            self._note_second_robot(allowed, candidates, positions, t)

    def _explain_undetected(self, below: tuple[str, ...] = ()) -> None:
        """Note why markers were not detected; `below`: those that were detected below the ground."""
        if below:
            self.notes.append(f"below the ground something like {', '.join(below)}")
            self.remedy = "uncover the markers; measure the places of the reference tags from the ground up"

    def _lookalike_note(self, lookalikes: BoolArray, positions: FloatArray) -> list[str]:
        """A note on candidates at `positions` (N, 2) [m] that look like a marker (K, N) and are not one."""
        listed = [
            f"{name} at ({x:.2f}, {y:.2f}) m"
            for name, row in zip(self.names, lookalikes, strict=True)
            for x, y in positions[row].tolist()
        ]
        if not listed:
            return []
        more = f" and {len(listed) - 3} more" if len(listed) > 3 else ""
        return [
            f"Other objects look like {', '.join(listed[:3])}{more}: they do not fit the layout, and are not "
            "tracked."
        ]

    def _recover(self, frame: Image, detections: list[D | None], t: float) -> list[D | None]:
        """The detections, with lost markers found again where the other markers and the time allow it."""
        candidates, allowed, _ = self._detect(frame)
        if not candidates:
            return detections
        positions = self._to_positions(candidates)
        known = self.plane.to_metres(
            np.array([(np.nan, np.nan) if d is None else d.centre for d in detections])
        )
        self._remember_lookalikes(allowed, positions, known)
        allowed = allowed & (positions[:, 1] > -_MAX_DEPTH) & ~self._at_lookalikes(positions)
        lost = np.array([d is None for d in detections])
        elapsed = t - self._last_times
        if lost.all():
            assigned = self._reacquire(allowed, positions, _MAX_JUMP + _MAX_WALKING_SPEED * elapsed)
            if (assigned >= 0).any() and len(self.notes) < _MAX_NOTES:
                lost_s = float(elapsed.min())
                self.notes.append(f"No marker was visible for {lost_s:.1f} s, until {t:.1f} s.")
        else:
            predicted = predict_positions(known[~lost], self._offsets[:, ~lost])
            reach = np.minimum(_MAX_JUMP + _RELATIVE_SPEED * elapsed, _MAX_SHIFT)
            assigned = assign_nearest(allowed & lost[:, None], positions, predicted, reach)
            near = np.minimum(_NEAR_RADIUS + _NEAR_GROWTH * elapsed, _MAX_NEAR_RADIUS)
            assigned = self._reject_unconfirmed(assigned, positions, predicted, near, t)
        return [
            d if d is not None or n < 0 else self._confirm(frame, k, candidates[n])
            for k, (d, n) in enumerate(zip(detections, assigned.tolist(), strict=True))
        ]

    def _reject_unconfirmed(
        self, assigned: IntArray, positions: FloatArray, predicted: FloatArray, near: FloatArray, t: float
    ) -> IntArray:
        """The `assigned` candidates (K,), without those that have not moved yet and lie beyond `near` (K,)
        [m] from their `predicted` positions [m]: an object of that colour may stand beside a covered
        marker."""
        assigned = assigned.copy()
        for k in np.flatnonzero(assigned >= 0).tolist():
            position = positions[assigned[k]]
            off = float(np.linalg.norm(position - predicted[k]))
            moved = float(np.linalg.norm(position - self._unconfirmed[k]))
            if off <= near[k]:
                continue
            if not _MIN_MOTION < moved < _MAX_JUMP:
                if not moved <= _MIN_MOTION:
                    self._unconfirmed[k] = position
                assigned[k] = -1
            elif off > _MAX_NEAR_RADIUS and len(self.notes) < _MAX_NOTES:
                self.notes.append(
                    f"At {t:.1f} s {self.names[k]} was found again {1e3 * off:.0f} mm from where the other "
                    "markers predict it: check it on the overlay."
                )
        return assigned

    def _reacquire(self, allowed: BoolArray, positions: FloatArray, reach: FloatArray) -> IntArray:
        """Candidates (K,) after all markers were lost: a set of the last layout, near the last positions."""
        count = len(self.names)
        moved = np.linalg.norm(positions - self._last_positions[:, None], axis=-1)
        sets = assign_candidates(
            allowed & (moved < reach[:, None]), positions, self._last_positions, count - 1
        )
        sets = [a for a in sets if a.rms < MAX_LAYOUT_RMS and len(a.markers) > count / 2]
        cost = np.array(
            [
                moved[a.markers, a.candidates[a.markers]].sum() + _MISSING_COST * (count - len(a.markers))
                for a in sets
            ]
        )
        order = np.argsort(cost, kind="stable")
        if not len(order):
            return np.full(count, -1, np.int32)
        best = sets[order[0]]
        mine = set(best.candidates[best.markers].tolist())
        for i in order[1:].tolist():
            if cost[i] >= max(2 * cost[order[0]], cost[order[0]] + count * AMBIGUITY_MARGIN):
                break
            if not mine & set(sets[i].candidates[sets[i].markers].tolist()):
                return np.full(count, -1, np.int32)  # another robot is as near
        return best.candidates

    def _reject_impossible(self, positions: FloatArray) -> FloatArray:
        """The positions (K, 2) [m], with NaN for those that this body cannot have."""
        if not self.acquired:
            return positions
        positions = positions.copy()
        positions[positions[:, 1] < -4 * _MAX_DEPTH] = np.nan
        distances = np.linalg.norm(positions[:, None] - positions, axis=-1) > self._max_distances
        while distances.any():
            worst = int(distances.sum(axis=0).argmax())
            positions[worst] = np.nan
            distances[worst] = distances[:, worst] = False
        return positions

    def _to_positions(self, candidates: Sequence[D]) -> FloatArray:
        return self.plane.to_metres(np.array([d.centre for d in candidates], float).reshape(-1, 2))
