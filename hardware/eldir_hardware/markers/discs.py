"""Coloured discs: found by hue, roundness and layout, and followed by their velocity."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from eldir.core.arguments import require_known
from eldir.core.records import BoolArray, FloatArray
from eldir_hardware.camera.plane import Image, Plane, TagBoard
from eldir_hardware.markers.disc import ColourModel, Disc, hue_angle, hue_difference, measure_disc
from eldir_hardware.markers.registration import DISC_DIAMETER, PALETTE, MarkerKind, nominal_bgr
from eldir_hardware.markers.tracker import MarkerTracker

_MIN_CHROMA = 25.0
"""Chroma above which a pixel may belong to a marker, in grey levels."""
_MAX_HUE_DIFFERENCE = np.radians(25.0)
"""How far a marker's hue may be from the printed one, and then from its own."""
_SEARCH_MARGIN = 6
"""Search range around a predicted position, before the whole frame is searched [px]."""
_STRENGTH_UPDATE_WEIGHT = 0.05
"""Weight of a new measurement in a marker's strength: light changes slowly along its path."""
_PAPER_RING_RADIUS = 0.58
"""Distance from a tag's centre at which its white paper is sampled [sides]: half a cell outside its
border."""
_MIN_COARSE_RADIUS = 2.5
"""A large picture is searched in a smaller copy in which discs still have this radius [px]."""
_MAX_RESIDUAL = 0.25
"""Largest residual of a disc that becomes a marker: half a disc has more."""
_MAX_CANDIDATE_RESIDUAL = 0.3
"""Largest residual of a disc that may become one, before its own colour is known."""
_MIN_BACKGROUND_SHARE = 0.05
"""A surface of a marker's hue that fills more of the picture explains why the marker is not found."""
_MAX_RESIDUAL_GROWTH = 0.06
"""Allowed growth of a disc's residual; a larger one means that part of the disc is covered."""
_DIAMETER_ERROR = 0.6
"""Error of a disc's diameter, for where it lies between the pixels of a compressed picture [px]."""


@dataclass
class _Track:
    """State of one marker."""

    target: FloatArray  # its chroma, learned
    matched_filter: FloatArray  # where it was last seen
    hue: float
    strength: float
    diameter: float  # as it appears [m]
    residual: float
    scale: float  # where it was last seen [px/m]
    pixel: FloatArray  # there [px]
    time: float
    velocity: FloatArray  # [px/s]

    @classmethod
    def start(cls, disc: Disc, target: FloatArray, scale: float, t: float) -> _Track:
        """A marker first seen as this disc, of chroma `target` (2,), at a scale [px/m] and a time [s]."""
        size = disc.size / scale
        return cls(
            target,
            disc.matched_filter,
            hue_angle(target),
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


class DiscTracker(MarkerTracker[Disc]):
    """Follows coloured discs."""

    appearance = "as on the printed sheet"
    is_coloured = True

    def __init__(
        self, plane: Plane, names: tuple[str, ...] = tuple(PALETTE), layout: FloatArray | None = None
    ):
        """As `MarkerTracker`. Raises `InputError` for a name that the palette does not have."""
        require_known("marker", names or "none", PALETTE)
        super().__init__(plane, names, layout)
        self.paper = None if plane.board is None else _paper_ring(plane, plane.board)
        self._colour: ColourModel | None = None
        self._tracks: list[_Track] = []
        middle = plane.to_metres((np.array(plane.size) - 1) / 2)
        radius = DISC_DIAMETER / 2 * float(plane.pixels_per_metre(middle))
        self._shrink = max(int(radius / _MIN_COARSE_RADIUS), 1)
        """Reduction factor of the picture in which discs are searched."""
        self.relative_size_error = _DIAMETER_ERROR / (2 * radius)

    def _detect(self, frame: Image) -> tuple[list[Disc], BoolArray, FloatArray]:
        if not self.acquired:
            self._colour = ColourModel.learn(frame, self.paper)
        assert self._colour is not None
        discs = self._candidates(frame)
        hues = (
            [track.hue for track in self._tracks]
            if self.acquired
            else [self._colour.marker_hue(n) for n in self.names]
        )
        differences = np.array([[hue_difference(h, disc.hue) for disc in discs] for h in hues])
        differences = differences.reshape(len(hues), len(discs))
        return discs, differences < _MAX_HUE_DIFFERENCE, differences + [disc.residual for disc in discs]

    def _start_tracks(self, frame: Image, chosen: list[Disc], t: float) -> list[Disc]:
        """Learn the colours of the markers; none if one of them is only part of a disc."""
        assert self._colour is not None
        scales = self.plane.pixels_per_metre(self.plane.to_metres(np.array([d.centre for d in chosen])))
        tracks: list[_Track] = []
        measured: list[Disc] = []
        for disc, scale in zip(chosen, scales.tolist(), strict=True):
            at = np.round(disc.centre).astype(int)
            target = self._colour.to_chroma(frame[at[1] - 2 : at[1] + 3, at[0] - 2 : at[0] + 3]).mean(
                axis=(0, 1)
            )
            again = measure_disc(frame, self._colour, disc.centre, disc.size / 2, target) or disc
            tracks.append(_Track.start(again, target, scale, t))
            measured.append(again)
        self.undetected = tuple(
            n for n, d in zip(self.names, measured, strict=True) if d.residual > _MAX_RESIDUAL
        )
        if self.undetected:
            self._explain_undetected()
            return []
        usual = float(np.median([disc.residual for disc in measured]))
        self.notes += [
            f"{name} does not look like a whole disc at {t:.1f} s: something of its colour is beside it, or "
            "part of it is covered; its position may be wrong by some millimetres: check it on the overlay."
            for name, disc in zip(self.names, measured, strict=True)
            if disc.residual > usual + 2 * _MAX_RESIDUAL_GROWTH
        ]
        self._tracks = tracks
        return measured

    def _explain_undetected(self, below: tuple[str, ...] = ()) -> None:
        """Name the markers whose colour the background has, too."""
        super()._explain_undetected(below)
        assert self._colour is not None
        shares = {name: self._colour.hue_share(name, _MAX_HUE_DIFFERENCE) for name in self.undetected}
        alike = ", ".join(
            f"{n} ({s:.0%} of the picture)" for n, s in shares.items() if s > _MIN_BACKGROUND_SHARE
        )
        if alike:
            self.notes.append(f"the background has the colour of {alike}")
            self.remedy = (
                "put a plain grey or white sheet behind and under the robot, or use numbered squares instead "
                "of discs (marker: aruco in the rig file)"
            )

    def _candidates(self, frame: Image) -> list[Disc]:
        """All discs in the frame that are vivid, and about as large and round as a marker."""
        assert self._colour is not None
        shrink = self._shrink
        small = cv2.resize(frame, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
        guesses = _connected_spots(self._colour.chroma_magnitude(small) > _MIN_CHROMA)
        if len(self._colour.surfaces):
            # A marker on a coloured surface is one spot with it, unless the surface's colour is left out. One
            # on grey, with something of its own colour elsewhere, is found as before.
            guesses = np.concatenate(
                [guesses, _connected_spots(self._colour.chroma_contrast(small) > _MIN_CHROMA)]
            )
        middles = (guesses[:, :2] + 0.5) * shrink - 0.5
        radii = DISC_DIAMETER / 2 * self.plane.pixels_per_metre(self.plane.to_metres(middles))
        sides = shrink * guesses[:, 2:]
        fitting = (sides.max(axis=1) <= 3 * radii + 4 * shrink) & (sides.min(axis=1) >= radii)
        discs: list[Disc] = []
        for middle, radius in zip(middles[fitting], radii[fitting].tolist(), strict=True):
            disc = measure_disc(frame, self._colour, middle, radius)
            if disc is None or disc.residual >= _MAX_CANDIDATE_RESIDUAL:
                continue
            if all(np.hypot(*(disc.centre - other.centre)) > radius for other in discs):
                discs.append(disc)
        return discs

    def _detect_nearby(self, frame: Image, t: float) -> list[Disc | None]:
        """Search each marker at the place that its velocity predicts."""
        return [self._detect_track(frame, track, t) for track in self._tracks]

    def _detect_track(self, frame: Image, track: _Track, t: float) -> Disc | None:
        assert self._colour is not None
        guess = track.pixel + track.velocity * min(t - track.time, 0.5)
        radius = track.radius
        reach = int(radius + _SEARCH_MARGIN)
        x, y = round(float(guess[0])), round(float(guess[1]))
        if not (reach <= x < frame.shape[1] - reach and reach <= y < frame.shape[0] - reach):
            return None
        patch = frame[y - reach : y + reach + 1, x - reach : x + reach + 1]
        weight = patch @ (track.matched_filter @ self._colour.basis)
        bright = weight > 0.5 * track.strength
        columns, rows = bright.sum(axis=0), bright.sum(axis=1)
        total = columns.sum()
        if total < 0.5 * np.pi * radius**2:
            return None
        side = np.arange(2 * reach + 1) - reach
        rough = np.array([x + columns @ side / total, y + rows @ side / total])
        disc = measure_disc(frame, self._colour, rough, radius, track.target)
        return disc if disc is not None and _matches(disc, track) else None

    def _confirm(self, frame: Image, k: int, candidate: Disc) -> Disc | None:
        assert self._colour is not None
        track = self._tracks[k]
        disc = measure_disc(frame, self._colour, candidate.centre, track.radius, track.target)
        return disc if disc is not None and _matches(disc, track) else None

    def _update_track(self, k: int, detection: Disc, scale: float, t: float) -> None:
        track = self._tracks[k]
        elapsed = t - track.time
        if elapsed > 0:
            track.velocity = (detection.centre - track.pixel) / elapsed
        track.pixel, track.scale, track.time = detection.centre, scale, t
        track.matched_filter = detection.matched_filter
        track.strength += _STRENGTH_UPDATE_WEIGHT * (detection.strength - track.strength)


def _matches(disc: Disc, track: _Track) -> bool:
    """Whether a disc looks like this marker, uncovered."""
    return (
        disc.residual < track.residual + _MAX_RESIDUAL_GROWTH
        and 0.5 < disc.strength / track.strength < 2.0
        and hue_difference(disc.hue, track.hue) < _MAX_HUE_DIFFERENCE
    )


def _connected_spots(mask: NDArray[np.bool_]) -> FloatArray:
    """Middle x and y, width and height [px] of each connected spot of a mask (H, W), shape (N, 4)."""
    # Grana's algorithm is four times as fast as the one that is used unasked.
    _, _, stats, middles = cv2.connectedComponentsWithStatsWithAlgorithm(
        mask.astype(np.uint8), 8, cv2.CV_32S, cv2.CCL_GRANA
    )
    large = np.flatnonzero(stats[:, cv2.CC_STAT_AREA] >= 8)
    large = large[large > 0]  # without the background
    return np.hstack([middles[large], stats[large][:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]])


def _paper_ring(plane: Plane, board: TagBoard) -> FloatArray:
    """Pixels (N, 2) on the white paper around the reference tags."""
    along = np.linspace(-1, 1, 9)
    ring = np.concatenate(
        [np.stack(p, axis=1) for a in (-1, 1) for p in ((along, np.full(9, a)), (np.full(9, a), along))]
    )
    return plane.to_pixels(board.centres[:, None] + _PAPER_RING_RADIUS * board.side_m * ring).reshape(-1, 2)


def _paint_disc(name: str, points: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """A disc with soft edges, so that its centre is exact: `MarkerKind.paint`."""
    outside = np.linalg.norm(points, axis=-1) - DISC_DIAMETER / 2
    return np.clip(0.5 - outside / width, 0, 1), (nominal_bgr(name) / 255) ** 2.2


MARKER = MarkerKind(DiscTracker, _paint_disc, DISC_DIAMETER, "coloured discs")
