"""Coloured discs: found by hue, roundness and layout, and followed by their velocity."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from eldir.core.arguments import require_known
from eldir.core.records import BoolArray, FloatArray
from eldir_hardware.camera.plane import Image, Plane, TagBoard
from eldir_hardware.markers.colour import ColourModel, between_hues, hue
from eldir_hardware.markers.disc import Disc, measure_disc
from eldir_hardware.markers.mark_sheet import MARK_DIAMETER, PALETTE, nominal_bgr
from eldir_hardware.markers.registration import MarkerKind
from eldir_hardware.markers.tracker import MarkerTracker

_VIVID = 25.0
"""Chroma above which a pixel may belong to a mark, in grey levels."""
_HUE = np.radians(25.0)
"""How far a mark's hue may be from the printed one, and then from its own."""
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
_CANDIDATE = 0.3
"""Largest residual of a disc that may become one, before its own colour is known."""
_SAME_COLOUR = 0.05
"""A surface of a mark's hue that fills more of the picture explains why the mark is not found."""
_WHOLE = 0.06
"""Allowed growth of a disc's residual; a larger one means that part of the disc is covered."""
_SIZE_ERROR = 0.6
"""Error of a disc's diameter, for where it lies between the pixels of a compressed picture [px]."""


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
        size = disc.size / scale
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


class DiscTracker(MarkerTracker[Disc]):
    """Follows coloured discs."""

    appearance = "as on the printed sheet"
    is_coloured = True

    def __init__(
        self, plane: Plane, names: tuple[str, ...] = tuple(PALETTE), layout: FloatArray | None = None
    ):
        """As `MarkerTracker`. Raises `InputError` for a name that the palette does not have."""
        require_known("mark", names or "none", PALETTE)
        super().__init__(plane, names, layout)
        self._paper = None if plane.board is None else _paper(plane, plane.board)
        self._colour: ColourModel | None = None
        self._tracks: list[_Track] = []
        middle = plane.to_metres((np.array(plane.size) - 1) / 2)
        radius = MARK_DIAMETER / 2 * float(plane.pixels_per_metre(middle))
        self._shrink = max(int(radius / _COARSE), 1)
        """Reduction factor of the picture in which discs are searched."""
        self.relative_size_error = _SIZE_ERROR / (2 * radius)

    def _detect(self, frame: Image) -> tuple[list[Disc], BoolArray, FloatArray]:
        if not self.acquired:
            self._colour = ColourModel.learn(frame, self._paper)
        assert self._colour is not None
        discs = self._candidates(frame)
        hues = (
            [track.hue for track in self._tracks]
            if self.acquired
            else [self._colour.hue_of_mark(n) for n in self.names]
        )
        apart = np.array([[between_hues(h, disc.hue) for disc in discs] for h in hues])
        apart = apart.reshape(len(hues), len(discs))
        return discs, apart < _HUE, apart + [disc.residual for disc in discs]

    def _begin(self, frame: Image, chosen: list[Disc], t: float) -> list[Disc]:
        """Learn the colours of the marks; none if one of them is only part of a disc."""
        assert self._colour is not None
        scales = self.plane.pixels_per_metre(self.plane.to_metres(np.array([d.centre for d in chosen])))
        tracks: list[_Track] = []
        measured: list[Disc] = []
        for disc, scale in zip(chosen, scales.tolist(), strict=True):
            at = np.round(disc.centre).astype(int)
            toward = self._colour.chroma(frame[at[1] - 2 : at[1] + 3, at[0] - 2 : at[0] + 3]).mean(
                axis=(0, 1)
            )
            again = measure_disc(frame, self._colour, disc.centre, disc.size / 2, toward) or disc
            tracks.append(_Track.start(again, toward, scale, t))
            measured.append(again)
        self.unseen = tuple(n for n, d in zip(self.names, measured, strict=True) if d.residual > _ROUND)
        if self.unseen:
            self._explain()
            return []
        usual = float(np.median([disc.residual for disc in measured]))
        self.notes += [
            f"{name} is no whole disc at {t:.1f} s: something of its colour is beside it, or part of it is "
            "covered; its place may be some millimetres off: check it on the overlay."
            for name, disc in zip(self.names, measured, strict=True)
            if disc.residual > usual + 2 * _WHOLE
        ]
        self._tracks = tracks
        return measured

    def _explain(self, below: tuple[str, ...] = ()) -> None:
        """Name the marks whose colour the background has, too."""
        super()._explain(below)
        assert self._colour is not None
        shares = {name: self._colour.share_of_hue(name, _HUE) for name in self.unseen}
        alike = ", ".join(f"{n} ({s:.0%} of the picture)" for n, s in shares.items() if s > _SAME_COLOUR)
        if alike:
            self.notes.append(f"the background has the colour of {alike}")
            self.remedy = (
                "put a plain grey or white sheet behind and under the robot, or use numbered squares instead "
                "of discs (marker: aruco in the rig file)"
            )

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
            if disc is None or disc.residual >= _CANDIDATE:
                continue
            if all(np.hypot(*(disc.centre - other.centre)) > radius for other in discs):
                discs.append(disc)
        return discs

    def _near(self, frame: Image, t: float) -> list[Disc | None]:
        """Search each mark at the place that its velocity predicts."""
        return [self._near_prediction(frame, track, t) for track in self._tracks]

    def _near_prediction(self, frame: Image, track: _Track, t: float) -> Disc | None:
        assert self._colour is not None
        guess = track.pixel + track.velocity * min(t - track.time, 0.5)
        radius = track.radius
        reach = int(radius + _SEARCH)
        x, y = round(float(guess[0])), round(float(guess[1]))
        if not (reach <= x < frame.shape[1] - reach and reach <= y < frame.shape[0] - reach):
            return None
        patch = frame[y - reach : y + reach + 1, x - reach : x + reach + 1]
        weight = patch @ (track.weights @ self._colour.basis)
        bright = weight > 0.5 * track.strength
        columns, rows = bright.sum(axis=0), bright.sum(axis=1)
        total = columns.sum()
        if total < 0.5 * np.pi * radius**2:
            return None
        side = np.arange(2 * reach + 1) - reach
        rough = np.array([x + columns @ side / total, y + rows @ side / total])
        disc = measure_disc(frame, self._colour, rough, radius, track.toward)
        return disc if disc is not None and _is(disc, track) else None

    def _confirm(self, frame: Image, k: int, candidate: Disc) -> Disc | None:
        assert self._colour is not None
        track = self._tracks[k]
        disc = measure_disc(frame, self._colour, candidate.centre, track.radius, track.toward)
        return disc if disc is not None and _is(disc, track) else None

    def _follow(self, k: int, detection: Disc, scale: float, t: float) -> None:
        track = self._tracks[k]
        elapsed = t - track.time
        if elapsed > 0:
            track.velocity = (detection.centre - track.pixel) / elapsed
        track.pixel, track.scale, track.time = detection.centre, scale, t
        track.weights = detection.toward
        track.strength += _LEARN * (detection.strength - track.strength)


def _is(disc: Disc, track: _Track) -> bool:
    """Whether a disc looks like this mark, uncovered."""
    return (
        disc.residual < track.residual + _WHOLE
        and 0.5 < disc.strength / track.strength < 2.0
        and between_hues(disc.hue, track.hue) < _HUE
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
    return plane.to_pixels(board.centres[:, None] + _RING * board.side_m * ring).reshape(-1, 2)


def _paint(name: str, points: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """A disc with soft edges, so that its centre is exact: `MarkerKind.paint`."""
    outside = np.linalg.norm(points, axis=-1) - MARK_DIAMETER / 2
    return np.clip(0.5 - outside / width, 0, 1), (nominal_bgr(name) / 255) ** 2.2


MARKER = MarkerKind(DiscTracker, _paint, MARK_DIAMETER, "coloured discs")
