"""What all kinds of markers have in common: they are found by layout, followed, and found again.

A kind of marker says which candidates a picture has and what they look like. Which of them are the markers
is decided here, by the design, the plane of motion and the motion so far. The position of a marker that is
partly covered or out of the picture is NaN; nothing is interpolated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Generic, Protocol, TypeVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.markers.assignment import (
    LAYOUT_LIMIT,
    SIMILAR,
    assign_candidates,
    find_stranger,
    fit_tilt,
    identify_markers,
    max_distances,
    turn,
)

_MAX_BELOW = 0.005
"""How far below the ground a marker may appear [m]: reflections lie below."""
_JUMP = 0.03
"""How far from its predicted place a marker may be found again at once [m]."""
_RELATIVE_SPEED, _MAX_SHIFT = 0.1, 0.08
"""And so much farther after each second [m/s], up to so far [m], while others of the body are seen: a motor
contracts by 40 mm at half that speed."""
_NEAR, _DRIFT, _MAX_NEAR = 0.005, 0.02, 0.012
"""How far from its predicted place a marker is taken again at once [m], how much farther after each second
[m/s], and up to so far [m]: a disc's width. Farther off, it could be a thing that looks like it."""
_MAX_COAST = 0.3
"""A marker that was lost for longer is not where its velocity predicts it [s]."""
_MOVED = 0.003
"""A candidate that has moved so far is no thing that stands about [m]."""
_WALK = 0.05
"""Largest speed of a robot of which nothing is seen [m/s]."""
_SAME_PLACE = 0.004
"""Within this distance, a candidate is the thing that was no marker before [m]."""
_CLEAR = 0.012
"""Of two candidates for a marker, the second must be this much farther from its predicted place [m], and
twice as far."""
_MISSING = 0.05
"""A marker that is not found counts as much as one that has moved so far [m]."""
_EVERY, _SEARCH_EVERY = 1.0, 4.0
"""Time between two checks of the markers' layout, and the longest between two searches for other robots,
each of which costs as much as four usual frames [s]."""
_MIN_SET = 3
"""Fewer markers of a second robot do not tell it from other things about."""
_MAX_NOTES = 8
_MAX_OTHERS = 200
_NEVER = 1e6


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
    """Follows the markers of one kind in the pictures of one camera."""

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
        self.unseen: tuple[str, ...] = names
        """Markers without a candidate in the last frame, until all markers are acquired."""
        self.notes: list[str] = []
        """What the user has to know about how the markers were found, or why they were not."""
        self.remedy = ""
        """What to do where notes say why markers were not found."""
        self._layout = None if layout is None else np.asarray(layout, np.float64).reshape(len(names), 2)
        self._first_sizes: FloatArray | None = None
        self._places: FloatArray = np.full((len(names), 2), np.nan)  # where each was last seen [m]
        self._times: FloatArray = np.zeros(len(names))  # and when [s]
        self._offsets: FloatArray = np.zeros((len(names), len(names), 2))  # of each from each other [m]
        self._farthest: FloatArray = np.zeros((len(names), len(names)))
        self._shape: FloatArray = np.zeros((len(names), 2))  # of the design, or as first seen [m]
        self._due = np.inf  # when the layout is checked again [s]
        self._search_due = np.inf  # when other robots are looked for again [s]
        self._search_step = _EVERY / 2
        self._others: FloatArray = np.zeros((0, 2))  # what looks like a marker and is none [m]
        self._lost: BoolArray = np.zeros(len(names), bool)  # not seen in the last frame
        self._strange: set[str] = set()  # markers that are noted as not at their places
        self._doubtful: FloatArray = np.full((len(names), 2), np.nan)  # candidates that have yet to move [m]

    @property
    def acquired(self) -> bool:
        """Whether all markers have been seen together, so that each has its name."""
        return self._first_sizes is not None

    def update(self, frame: Image, t: float) -> FloatArray:
        """Positions (K, 2) [m] of the markers in a frame (H, W, 3) BGR taken at t [s]; NaN where not seen.

        Raises `InputError` where the first markers are ambiguous, or not where the design has them.
        """
        self.plane.require_size(frame.shape[1], frame.shape[0])
        if self.acquired:
            found = self._without_stale(self._near(frame, t), t)
            if None in found:
                found = self._recover(frame, found, t)
        else:
            found = [*self._acquire(frame, t)] or [None] * len(self.names)
        centres = np.array([(np.nan, np.nan) if d is None else d.centre for d in found])
        places = self._within_reach(self.plane.to_metres(centres))
        scales = self.plane.pixels_per_metre(places)
        sizes = np.array([np.nan if d is None else d.size for d in found]) / scales
        if self._first_sizes is None:
            if np.isnan(places).any():
                return places
            self._first_sizes = sizes
        seen = np.isfinite(places[:, 0])
        self._lost = ~seen
        self.sizes = np.where(seen, sizes / self._first_sizes, np.nan)
        self._places[seen], self._times[seen], self._doubtful[seen] = places[seen], t, np.nan
        both = seen[:, None] & seen
        self._offsets[both] = (places[:, None] - places)[both]
        for k, detection in enumerate(found):
            if detection is not None and seen[k]:
                self._follow(k, detection, float(scales[k]), t)
        self._check_layout(places, t)
        self._search_others(frame, places, t)
        return places

    def _check_layout(self, places: FloatArray, t: float) -> None:
        """From time to time, note a marker that is not where the others have it: it may be locked to a thing
        beside it."""
        if t < self._due:
            return
        self._due = t + _EVERY
        seen = np.flatnonzero(np.isfinite(places[:, 0]))
        names = tuple(self.names[k] for k in seen)
        strange = find_stranger(names, places[seen], self._shape[seen])
        name = strange.partition(" ")[0]
        if strange and name not in self._strange:
            self._strange.add(name)
            self.notes.append(f"At {t:.1f} s {strange}: check it on the overlay.")

    def _search_others(self, frame: Image, places: FloatArray, t: float) -> None:
        """From time to time, look whether a second robot is in view, and note it once."""
        if t < self._search_due or len(self.names) < _MIN_SET:
            return
        self._search_due = t + self._search_step
        self._search_step = min(2 * self._search_step, _SEARCH_EVERY)
        candidates, allowed, _ = self._detect(frame)
        found = self._places_of(candidates)
        self._remember(allowed, found, places)
        self._note_others(allowed, found, places, t)

    def _note_others(self, allowed: BoolArray, found: FloatArray, places: FloatArray, t: float) -> None:
        """Note a second set among candidates `found` (N, 2) [m], with ours at `places` (K, 2) [m]; once."""
        own = np.linalg.norm(found[:, None] - places, axis=-1) < _CLEAR
        allowed = allowed & (found[:, 1] > -_MAX_BELOW) & ~own.any(axis=1)
        missing = len(self.names) - max(_MIN_SET, len(self.names) - 2)
        sets = assign_candidates(allowed, found, self._shape, missing)
        if sets and sets[0].rms < LAYOUT_LIMIT:
            self._search_due = np.inf
            k = int(sets[0].markers[0])
            x, y = found[sets[0].candidates[k]] + 0.0
            own_x, own_y = (places if np.isfinite(places[k, 0]) else self._places)[k] + 0.0
            self.notes.append(
                f"At {t:.1f} s a second set of markers is in view, {self.names[k]} at ({x:.2f}, {y:.2f}) m; "
                f"the tracked one has it at ({own_x:.2f}, {own_y:.2f}) m: check on the overlay that the "
                "right robot is tracked."
            )

    def _remember(self, allowed: BoolArray, candidates: FloatArray, places: FloatArray) -> None:
        """Note which candidates (N, 2) [m] are none of the markers that they look like (K, N), as these are
        seen at other `places` (K, 2) [m]: what stands there is no marker later, either."""
        far = np.linalg.norm(candidates - places[:, None], axis=-1) > _CLEAR  # not where nothing is seen
        new = (far | ~allowed).all(axis=0) & allowed.any(axis=0)
        self._others = np.concatenate([self._others, candidates[new & ~self._stood(candidates)]])[
            -_MAX_OTHERS:
        ]

    def _stood(self, candidates: FloatArray) -> BoolArray:
        """Which candidates (N, 2) [m] are where something was that is no marker."""
        apart = np.linalg.norm(candidates[:, None] - self._others, axis=-1)
        return np.asarray((apart < _SAME_PLACE).any(axis=1))

    @abstractmethod
    def _detect(self, frame: Image) -> tuple[list[D], BoolArray, FloatArray]:
        """Candidates in the whole frame, which look like which marker (K, N), and how much they differ from
        its printed appearance (K, N)."""

    @abstractmethod
    def _confirm(self, frame: Image, k: int, candidate: D) -> D | None:
        """A candidate measured as marker k; None if it does not look like it."""

    def _near(self, frame: Image, t: float) -> list[D | None]:
        """Markers that are found without a search of the whole frame."""
        return [None] * len(self.names)

    def _without_stale(self, found: list[D | None], t: float) -> list[D | None]:
        """What was found nearby, without markers that had been lost and may be something else."""
        if not self._lost.any():
            return found
        places = self.plane.to_metres(np.array([(np.nan, np.nan) if d is None else d.centre for d in found]))
        stale = self._lost & ((t - self._times > _MAX_COAST) | self._stood(places))
        return [None if bad else d for d, bad in zip(found, stale.tolist(), strict=True)]

    def _begin(self, frame: Image, chosen: list[D], t: float) -> list[D]:
        """The markers measured once it is known which they are; none where they are not good enough."""
        return chosen

    def _follow(self, k: int, detection: D, scale: float, t: float) -> None:
        """Take note of where marker k is, at a scale [px/m]."""

    def _acquire(self, frame: Image, t: float) -> Sequence[D]:
        """Name the markers in the first frame that shows them all."""
        candidates, allowed, differences = self._detect(frame)
        places = self._places_of(candidates)
        self.notes = []
        below = places[:, 1] < -_MAX_BELOW
        above = allowed & ~below
        self.unseen = tuple(n for n, row in zip(self.names, above, strict=True) if not row.any())
        if self.unseen:
            self._explain(tuple(n for n in self.unseen if allowed[self.names.index(n)].any()))
            return []
        chosen, notes = identify_markers(self.names, above, differences, places, self._layout)
        if chosen is None:
            self.notes = notes
            self.remedy = "uncover the markers, and check which is glued to which mass"
            return []
        found = self._begin(frame, [candidates[c] for c in chosen.tolist()], t)
        if not found:
            return []
        usual = differences[np.arange(len(chosen)), chosen]
        others = allowed.copy()
        others[:, chosen] = False
        self._others = places[others.any(axis=0)]
        alike = others & (differences < usual[:, None] + SIMILAR)
        self.notes += notes + self._tell_others(alike & ~below, places)
        self._shape = places[chosen] if self._layout is None else self._layout
        self._farthest = max_distances(self._shape)
        self._due = t + _EVERY
        self._search_due = t + self._search_step  # ours may be covered in this frame, and another one not
        if len(self.names) >= _MIN_SET:
            self._note_others(allowed, places, places[chosen], t)
        return found

    def _explain(self, below: tuple[str, ...] = ()) -> None:
        """Take note of why markers are not seen; `below`: seen below the ground."""
        if below:
            self.notes.append(f"below the ground something like {', '.join(below)}")
            self.remedy = "uncover the markers; measure the places of the reference tags from the ground up"

    def _tell_others(self, alike: BoolArray, places: FloatArray) -> list[str]:
        """A note about what looks like a marker and is none; `alike` (K, N)."""
        told = [
            f"{name} at ({x:.2f}, {y:.2f}) m"
            for name, row in zip(self.names, alike, strict=True)
            for x, y in places[row].tolist()
        ]
        if not told:
            return []
        more = f" and {len(told) - 3} more" if len(told) > 3 else ""
        return [
            f"Things that look like {', '.join(told[:3])}{more} are taken as no marker: they do not fit "
            "the layout."
        ]

    def _recover(self, frame: Image, found: list[D | None], t: float) -> list[D | None]:
        """Find the markers again that are not `found`, where the others and the time allow them to be."""
        candidates, allowed, _ = self._detect(frame)
        if not candidates:
            return found
        places = self._places_of(candidates)
        known = self.plane.to_metres(np.array([(np.nan, np.nan) if d is None else d.centre for d in found]))
        self._remember(allowed, places, known)
        allowed = allowed & (places[:, 1] > -_MAX_BELOW) & ~self._stood(places)
        lost = np.array([d is None for d in found])
        elapsed = t - self._times
        if lost.all():
            chosen = self._again(allowed, places, _JUMP + _WALK * elapsed)
            if (chosen >= 0).any() and len(self.notes) < _MAX_NOTES:
                lost_s = float(elapsed.min())
                self.notes.append(f"No marker was seen for {lost_s:.1f} s, until {t:.1f} s.")
        else:
            predicted = _predict(known[~lost], self._offsets[:, ~lost])
            reach = np.minimum(_JUMP + _RELATIVE_SPEED * elapsed, _MAX_SHIFT)
            chosen = _nearest(allowed & lost[:, None], places, predicted, reach)
            near = np.minimum(_NEAR + _DRIFT * elapsed, _MAX_NEAR)
            chosen = self._without_doubtful(chosen, places, predicted, near, t)
        return [
            d if d is not None or n < 0 else self._confirm(frame, k, candidates[n])
            for k, (d, n) in enumerate(zip(found, chosen.tolist(), strict=True))
        ]

    def _without_doubtful(
        self, chosen: IntArray, places: FloatArray, predicted: FloatArray, near: FloatArray, t: float
    ) -> IntArray:
        """The candidates `chosen` (K,), without those that are not `near` (K,) [m] their `predicted` places
        [m] and have not been seen to move: a cap of that colour may stand beside a marker that is covered."""
        chosen = chosen.copy()
        for k in np.flatnonzero(chosen >= 0).tolist():
            place = places[chosen[k]]
            off = float(np.linalg.norm(place - predicted[k]))
            moved = float(np.linalg.norm(place - self._doubtful[k]))
            if off <= near[k]:
                continue
            if not _MOVED < moved < _JUMP:
                if not moved <= _MOVED:
                    self._doubtful[k] = place
                chosen[k] = -1
            elif off > _MAX_NEAR and len(self.notes) < _MAX_NOTES:
                self.notes.append(
                    f"At {t:.1f} s {self.names[k]} was found again {1e3 * off:.0f} mm from where the other "
                    "markers predict it: check it on the overlay."
                )
        return chosen

    def _again(self, allowed: BoolArray, places: FloatArray, reach: FloatArray) -> IntArray:
        """Candidates of the markers when none is known: a set of the last shape, near the last place."""
        count = len(self.names)
        moved = np.linalg.norm(places - self._places[:, None], axis=-1)
        sets = assign_candidates(allowed & (moved < reach[:, None]), places, self._places, count - 1)
        sets = [a for a in sets if a.rms < LAYOUT_LIMIT and len(a.markers) > count / 2]
        cost = np.array(
            [
                moved[a.markers, a.candidates[a.markers]].sum() + _MISSING * (count - len(a.markers))
                for a in sets
            ]
        )
        order = np.argsort(cost, kind="stable")
        if not len(order):
            return np.full(count, -1, np.int32)
        best = sets[order[0]]
        mine = set(best.candidates[best.markers].tolist())
        for i in order[1:].tolist():
            if cost[i] >= max(2 * cost[order[0]], cost[order[0]] + count * _CLEAR):
                break
            if not mine & set(sets[i].candidates[sets[i].markers].tolist()):
                return np.full(count, -1, np.int32)  # another robot is as near
        return best.candidates

    def _within_reach(self, places: FloatArray) -> FloatArray:
        """The places (K, 2) [m], without those that this body cannot have."""
        if not self.acquired:
            return places
        places = places.copy()
        places[places[:, 1] < -4 * _MAX_BELOW] = np.nan
        apart = np.linalg.norm(places[:, None] - places, axis=-1) > self._farthest
        while apart.any():
            worst = int(apart.sum(axis=0).argmax())
            places[worst] = np.nan
            apart[worst] = apart[:, worst] = False
        return places

    def _places_of(self, candidates: Sequence[D]) -> FloatArray:
        return self.plane.to_metres(np.array([d.centre for d in candidates], float).reshape(-1, 2))


def _predict(known: FloatArray, offsets: FloatArray) -> FloatArray:
    """Where a body has its markers (K, 2) [m], of which some are `known` (N, 2) [m] now, and all once had
    these `offsets` from them (K, N, 2) [m]: it has shifted and tilted since."""
    middle, centre = known.mean(axis=0), offsets.mean(axis=1)
    tilt = fit_tilt(centre[:, None] - offsets, known - middle)
    return middle + turn(centre, tilt[:, 0])


def _nearest(allowed: BoolArray, places: FloatArray, predicted: FloatArray, reach: FloatArray) -> IntArray:
    """For each marker the candidate nearest to its `predicted` place (K, 2) [m] within `reach` (K,) [m], all
    at once; -1 where there is none, or another is about as near."""
    far = np.linalg.norm(places - predicted[:, None], axis=-1)
    far = np.where(allowed & (far < reach[:, None]), far, _NEVER)
    chosen = np.full(len(far), -1, np.int32)
    for k, n in zip(*linear_sum_assignment(far), strict=True):
        others = np.delete(far[k], n)
        if far[k, n] < _NEVER and others.min(initial=_NEVER) > max(2 * far[k, n], far[k, n] + _CLEAR):
            chosen[k] = n
    return chosen
