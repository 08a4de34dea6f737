"""Tracks the marks m1, m2, ...: they are found by hue and layout, predicted from frame to frame, and gated.

The position of a mark that is partly covered or out of the picture is NaN; nothing is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from calibration.camera.plane import Image, Plane, TagBoard
from eldir.core.records import FloatArray
from eldir.errors import InputError
from hardware.images.mark_sheet import MARK_DIAMETER, PALETTE
from hardware.vision.colour import ColourModel, between_hues, hue
from hardware.vision.disc import Disc, measure_disc

_VIVID = 25.0
"""Chroma above which a pixel may belong to a mark, in grey levels."""
_HUE = np.radians(25.0)
"""How far a mark's hue may be from the printed one, and then from its own."""
_LAYOUT = 0.02
"""Distance of marks from their places in the design that is always accepted at the first frame [m]."""
_TURN = np.radians(60.0)
"""Largest tilt of a body at the start."""
_SPEED, _JUMP = 1.0, 0.03
"""Largest speed of a mass [m/s], and an additional distance [m]."""
_SEARCH = 6
"""Search range around a predicted position, before the whole frame is searched [px]."""
_LEARN = 0.05
"""Weight of a new measurement in a mark's strength: light changes slowly along its path."""
_RING = 0.58
"""Distance from a tag's centre at which its white paper is looked at [sides]: half a cell off its border."""
_COARSE = 2.5
"""A large picture is searched in a smaller copy in which discs still have this radius [px]."""
_ROUND = 0.25
"""Largest residual of a disc that becomes a mark: half a disc has more."""
_SAME_COLOUR = 0.05
"""A surface of a mark's hue that fills more of the picture explains why the mark is not found."""
_WHOLE = 0.06
"""Allowed growth of a disc's residual; a larger one means that part of the disc is covered."""


@dataclass
class _Track:
    """State of one mark."""

    toward: FloatArray  # its chroma, learned
    weights: FloatArray  # of a pixel's chroma, where it was last seen
    hue: float
    strength: float
    diameter: float  # as it appears [m]
    residual: float
    scale: float  # where it was last seen [px/m]
    pixel: FloatArray  # there [px]
    time: float
    velocity: FloatArray  # [px/s]

    @classmethod
    def start(cls, disc: Disc, toward: FloatArray, scale: float, t: float) -> _Track:
        """A mark first seen as this disc, of chroma `toward` (2,), at a scale [px/m] and a time [s]."""
        size = float(_diameters(disc.area)) / scale
        return cls(
            toward,
            disc.toward,
            hue(toward),
            disc.strength,
            size,
            disc.residual,
            scale,
            disc.centre,
            t,
            np.zeros(2),
        )

    @property
    def radius(self) -> float:
        """Radius of the disc when it was last seen [px]."""
        return self.diameter / 2 * self.scale


class Tracker:
    """Follows marks in the pictures of one camera."""

    def __init__(
        self, plane: Plane, names: tuple[str, ...] = tuple(PALETTE), layout: FloatArray | None = None
    ):
        """`layout` (K, 2) [m]: where the design has the marks `names`, up to shift and tilt."""
        unknown = [name for name in names if name not in PALETTE]
        if unknown or not names:
            raise InputError(
                "no such mark on the printed sheet", expected=", ".join(PALETTE), found=", ".join(unknown)
            )
        self.plane = plane
        self.names = names
        self._paper = None if plane.board is None else _paper(plane, plane.board)
        self._layout = None if layout is None else np.asarray(layout, np.float64).reshape(len(names), 2)
        self._colour: ColourModel | None = None
        self._tracks: list[_Track] = []
        middle = plane.to_metres((np.array(plane.size) - 1) / 2)
        radius = MARK_DIAMETER / 2 * float(plane.pixels_per_metre(middle))
        self._shrink = max(int(radius / _COARSE), 1)
        """Reduction factor of the picture in which discs are searched."""
        self.sizes: FloatArray = np.full(len(names), np.nan)
        """Apparent size of each mark in the last frame, relative to its first size, shape (K,)."""
        self.unseen: tuple[str, ...] = names
        """Marks without a similar disc in the last frame, until all marks are acquired."""
        self.camouflaged: dict[str, float] = {}
        """Those of them whose colour fills a large part of the picture, and which part."""

    @property
    def acquired(self) -> bool:
        """Whether all marks have been seen together, so that each has its name."""
        return bool(self._tracks)

    def update(self, frame: Image, t: float) -> FloatArray:
        """Positions (K, 2) [m] of the marks in a frame (H, W, 3) BGR taken at t [s]; NaN where not seen."""
        self.plane.require_size(frame.shape[1], frame.shape[0])
        discs = self._look(frame, t)
        if not discs:
            return np.full((len(self.names), 2), np.nan)
        pixels = np.array([(np.nan, np.nan) if disc is None else disc.centre for disc in discs])
        areas = np.array([np.nan if disc is None else disc.area for disc in discs])
        places = self.plane.to_metres(pixels)
        scales = self.plane.pixels_per_metre(places)
        self.sizes = _diameters(areas) / scales / [track.diameter for track in self._tracks]
        for track, disc, scale in zip(self._tracks, discs, scales.tolist(), strict=True):
            if disc is not None:
                _follow(track, disc, scale, t)
        return places

    def _look(self, frame: Image, t: float) -> list[Disc | None]:
        """The disc of each mark, None where it is not seen; nothing before all have been seen together."""
        if not self._tracks:
            return [*self._acquire(frame, t)]
        discs = [self._near(frame, track, t) for track in self._tracks]
        return self._anywhere(frame, discs, t) if None in discs else discs

    def _acquire(self, frame: Image, t: float) -> list[Disc]:
        """Name the marks in the first frame that shows them all, and learn their colours."""
        self._colour = ColourModel.learn(frame, self._paper)
        discs = self._candidates(frame)
        printed = [self._colour.hue_of_mark(name) for name in self.names]
        apart = np.array([[between_hues(p, disc.hue) for disc in discs] for p in printed])
        self._miss([n for n, row in zip(self.names, apart, strict=True) if not (row < _HUE).any()])
        if self.unseen or len(discs) < len(self.names):
            return []
        # Where two discs could be the same mark, the rounder is it.
        cost = apart + np.array([disc.residual for disc in discs])
        rows, chosen = linear_sum_assignment(cost)
        if (apart[rows, chosen] > _HUE).any():
            return []
        discs = [discs[c] for c in chosen]
        found = self.plane.to_metres(np.array([disc.centre for disc in discs]))
        if self._layout is not None:
            _check_layout(self.names, found, self._layout)
        scales = self.plane.pixels_per_metre(found)
        tracks: list[_Track] = []
        measured: list[Disc] = []
        for disc, scale in zip(discs, scales.tolist(), strict=True):
            at = np.round(disc.centre).astype(int)
            toward = self._colour.chroma(frame[at[1] - 2 : at[1] + 3, at[0] - 2 : at[0] + 3]).mean(
                axis=(0, 1)
            )
            radius = float(_diameters(disc.area)) / 2
            again = measure_disc(frame, self._colour, disc.centre, radius, toward) or disc
            tracks.append(_Track.start(again, toward, scale, t))
            measured.append(again)
        self._miss([n for n, disc in zip(self.names, measured, strict=True) if disc.residual > _ROUND])
        if self.unseen:
            return []
        self._tracks = tracks
        return measured

    def _miss(self, names: list[str]) -> None:
        """Note which marks have no similar disc, and those whose colour the background has."""
        assert self._colour is not None
        self.unseen = tuple(names)
        shares = {name: self._colour.share_of_hue(name, _HUE) for name in names}
        self.camouflaged = {name: share for name, share in shares.items() if share > _SAME_COLOUR}

    def _candidates(self, frame: Image) -> list[Disc]:
        """All discs in the frame that are vivid, and about as large and round as a mark."""
        assert self._colour is not None
        shrink = self._shrink
        small = cv2.resize(frame, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
        guesses = _spots(self._colour.vividness(small) > _VIVID)
        if len(self._colour.surfaces):
            # A mark on a coloured surface is one spot with it, unless the surface's colour is left out. One
            # on grey, with something of its own colour elsewhere, is found as before.
            guesses = np.concatenate([guesses, _spots(self._colour.contrast(small) > _VIVID)])
        middles = (guesses[:, :2] + 0.5) * shrink - 0.5
        radii = MARK_DIAMETER / 2 * self.plane.pixels_per_metre(self.plane.to_metres(middles))
        sides = shrink * guesses[:, 2:]
        fitting = (sides.max(axis=1) <= 3 * radii + 4 * shrink) & (sides.min(axis=1) >= radii)
        discs: list[Disc] = []
        for middle, radius in zip(middles[fitting], radii[fitting].tolist(), strict=True):
            disc = measure_disc(frame, self._colour, middle, radius)
            if disc is None or disc.residual >= 0.3:
                continue
            if all(np.hypot(*(disc.centre - other.centre)) > radius for other in discs):
                discs.append(disc)
        return discs

    def _near(self, frame: Image, track: _Track, t: float) -> Disc | None:
        """Search the mark at the place that its velocity predicts."""
        assert self._colour is not None
        guess = track.pixel + track.velocity * min(t - track.time, 0.5)
        radius = track.radius
        reach = int(radius + _SEARCH)
        x, y = np.round(guess).astype(int)
        if not (reach <= x < frame.shape[1] - reach and reach <= y < frame.shape[0] - reach):
            return None
        patch = frame[y - reach : y + reach + 1, x - reach : x + reach + 1]
        weight = self._colour.chroma(patch) @ track.weights.astype(np.float32)
        bright = weight > 0.5 * track.strength
        columns, rows = bright.sum(axis=0), bright.sum(axis=1)
        total = columns.sum()
        if total < 0.5 * np.pi * radius**2:
            return None
        side = np.arange(2 * reach + 1) - reach
        rough = np.array([x + columns @ side / total, y + rows @ side / total])
        disc = measure_disc(frame, self._colour, rough, radius, track.toward)
        return disc if disc is not None and self._is(disc, track, t) else None

    def _anywhere(self, frame: Image, known: list[Disc | None], t: float) -> list[Disc | None]:
        """Search the marks that are not `known` in the whole frame; of two similar discs take the rounder."""
        assert self._colour is not None
        candidates = self._candidates(frame)
        found = list(known)
        for k, track in enumerate(self._tracks):
            if known[k] is not None:
                continue
            alike = [d for d in candidates if between_hues(d.hue, track.hue) <= _HUE]
            again = [measure_disc(frame, self._colour, d.centre, track.radius, track.toward) for d in alike]
            fitting = [d for d in again if d is not None and self._is(d, track, t)]
            found[k] = min(fitting, key=lambda d: d.residual, default=None)
        return found

    def _is(self, disc: Disc, track: _Track, t: float) -> bool:
        """Whether a disc is this mark, uncovered, at a place that the mark can have reached."""
        reach = _JUMP + _SPEED * max(t - track.time, 0.0)
        moved = np.hypot(*(disc.centre - track.pixel)) / track.scale
        return (
            disc.residual < track.residual + _WHOLE
            and 0.5 < disc.strength / track.strength < 2.0
            and between_hues(disc.hue, track.hue) < _HUE
            and bool(moved < reach)
        )


def _spots(mask: NDArray[np.bool_]) -> FloatArray:
    """Middle x and y, width and height [px] of each connected spot of a mask (H, W), shape (N, 4)."""
    # Grana's algorithm is four times as fast as the one that is used unasked.
    _, _, stats, middles = cv2.connectedComponentsWithStatsWithAlgorithm(
        mask.astype(np.uint8), 8, cv2.CV_32S, cv2.CCL_GRANA
    )
    large = np.flatnonzero(stats[:, cv2.CC_STAT_AREA] >= 8)
    large = large[large > 0]  # without the background
    return np.hstack([middles[large], stats[large][:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]])


def _paper(plane: Plane, board: TagBoard) -> FloatArray:
    """Pixels (N, 2) on the white paper around the fixed tags."""
    along = np.linspace(-1, 1, 9)
    ring = np.concatenate(
        [np.stack(p, axis=1) for a in (-1, 1) for p in ((along, np.full(9, a)), (np.full(9, a), along))]
    )
    return plane.to_pixels(board.centres[:, None] + _RING * board.side * ring).reshape(-1, 2)


def _diameters(areas: FloatArray | float) -> FloatArray:
    """Diameters of discs with these areas [px2], in pixels."""
    return 2 * np.sqrt(np.asarray(areas) / np.pi)


def _follow(track: _Track, disc: Disc, scale: float, t: float) -> None:
    elapsed = t - track.time
    if elapsed > 0:
        track.velocity = (disc.centre - track.pixel) / elapsed
    track.pixel, track.scale, track.time, track.weights = disc.centre, scale, t, disc.toward
    track.strength += _LEARN * (disc.strength - track.strength)


def _check_layout(names: tuple[str, ...], found: FloatArray, layout: FloatArray) -> None:
    """Raise `InputError` if the marks with other names would fit the design much better.

    A body that sags or has folded does not match the design either, but other names do not fit better.
    """
    if _apart(layout, found) <= _LAYOUT:
        return
    orders = [list(order) for order in permutations(range(len(names)))]
    off = np.array([_apart(layout[order], found) for order in orders])
    best = int(off.argmin())
    if off[best] < off[0] / 2:
        seem = ", ".join(
            f"{names[to]} where {name} should be"
            for name, to in zip(names, np.argsort(orders[best]), strict=True)
            if names[to] != name
        )
        raise InputError(
            "the marks are not at their places in the design",
            expected=f"every mark near its place, within {1e3 * _LAYOUT:.0f} mm",
            found=f"probably {seem}",
            remedy="check which mark is glued to which mass, and that this is the robot's design",
        )


def _apart(layout: FloatArray, found: FloatArray) -> float:
    """RMS distance [m] of points (K, 2) after the best shift and the best rotation of up to 60 degrees."""
    a, b = layout - layout.mean(axis=0), found - found.mean(axis=0)
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    cos, sin = np.cos(np.clip(angle, -_TURN, _TURN)), np.sin(np.clip(angle, -_TURN, _TURN))
    turned = a @ np.array([[cos, sin], [-sin, cos]])
    return float(np.sqrt(((turned - b) ** 2).sum(axis=1).mean()))
