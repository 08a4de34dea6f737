"""The sheets to print: markers and reference tags in their true size, each with a scale bar."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import TYPE_CHECKING

import cv2
import numpy as np

from eldir.core.arguments import require_value
from eldir.core.records import FloatArray
from eldir_hardware.camera.plane import Image
from eldir_hardware.markers.registration import PALETTE, MarkerKind
from eldir_hardware.markers.squares import square_cells

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCALE_BAR = 0.1
"""Length of the scale bar [m]."""
_PAGE = np.array([0.210, 0.297])  # A4 [m]
_TOP, _BOTTOM, _SIDE = 0.03, 0.04, 0.012  # margins [m]
_GAP = 0.006  # between what is cut out [m]
_DOT_SIZE = 0.0254 / 600  # [m]
_COPIES = 4
_TAG_PAPER = 1.4  # width of the white paper around a tag, in sides of the tag
_PIXELS = 32  # of a picture, along a cell of a tag
MAX_TAG_SIDE = 0.128
"""Largest side of a reference tag, for whose paper a page is wide enough [m]."""
_CHECK_TEXT = (
    "Print at 100 % (actual size), do not fit to the page. Check with calipers: the bar below is 100.0 mm\n"
    "long, from its left to its right edge. If it is not within 0.5 mm, print again."
)

Drawing = Callable[[FloatArray, float], tuple[FloatArray, FloatArray]]
"""Cover and reflectance at points, as `MarkerKind.paint` without the name."""


def marker_pages(kind: MarkerKind, masses: Sequence[int] | None = None) -> Iterator[Figure]:
    """A page with a few copies of each marker of this kind. `masses`: the masses of m1, m2, ... of a robot,
    which may have fewer than five; by default a sheet for any robot."""

    def drawing(name: str) -> Drawing:
        return lambda points, width: kind.paint(name, points, width)

    labels = {name: name for name in PALETTE}
    if masses is not None:
        labels = {name: f"{name}, mass {mass}" for name, mass in zip(PALETTE, masses, strict=False)}
    pictures = {label: _rasterise(drawing(name), kind.width) for name, label in labels.items()}
    cells = [(label, picture, kind.width) for label, picture in pictures.items() for _ in range(_COPIES)]
    return _lay_out_pages(f"eldir markers {' '.join(labels)}: {kind.description}", cells, kind.width)


def tag_pages(dictionary: str, count: int, side: float) -> Iterator[Figure]:
    """Pages with the reference tags 0 to `count` - 1, black squares of this side [m], each upright. Raises
    `InputError` for tags that a page cannot hold."""
    require_value("side of the tags", side <= MAX_TAG_SIDE, f"at most {MAX_TAG_SIDE:g} m, for A4", side)
    cells = (
        (f"tag {number}, this side up", _enlarge(square_cells(dictionary, number)), side)
        for number in range(count)
    )
    title = f"eldir reference tags {dictionary}: black squares of {1e3 * side:.1f} mm"
    return _lay_out_pages(title, cells, _TAG_PAPER * side)


def _lay_out_pages(title: str, cells: Iterable[tuple[str, Image, float]], width: float) -> Iterator[Figure]:
    """Pages with pictures in the middle of squares of white paper that are `width` wide [m]. `cells`: label,
    picture, and width of the picture [m]."""
    from matplotlib.figure import Figure

    pitch = width + _GAP
    columns, rows = ((_PAGE - (2 * _SIDE, _TOP + _BOTTOM)) / (pitch, pitch + _GAP)).astype(int)
    waiting = iter(cells)
    while page := list(islice(waiting, int(columns * rows))):
        figure = Figure(figsize=tuple(_PAGE / 0.0254))
        figure.text(0.5, 1 - 0.015 / _PAGE[1], title, ha="center", fontsize=11)
        for number, (label, picture, size) in enumerate(page):
            row, column = divmod(number, int(columns))
            left = (_PAGE[0] - columns * pitch + _GAP) / 2 + column * pitch
            bottom = _PAGE[1] - _TOP - row * (pitch + _GAP) - width
            margin = (width - size) / 2
            _place_picture(figure, picture, left + margin, bottom + margin, size)
            middle = (left + width / 2) / _PAGE[0]
            figure.text(middle, (bottom - 0.0035) / _PAGE[1], label, ha="center", fontsize=6)
        _draw_scale_bar(figure)
        yield figure


def _enlarge(cells: Image) -> Image:
    """The cells of a tag as a picture, RGB (n, n, 3). Its pixels end where cells end, so edges are exact."""
    return np.repeat(np.kron(cells, np.ones((_PIXELS, _PIXELS), np.uint8))[..., None], 3, axis=2)


def _rasterise(drawing: Drawing, width: float) -> Image:
    """The marker on white at 600 dots an inch, RGB (n, n, 3). What has no colour is black and white, so that
    the printer needs no halftone."""
    steps = (np.arange(round(width / _DOT_SIZE)) + 0.5) * _DOT_SIZE - width / 2
    points = np.stack(np.meshgrid(steps, -steps), axis=-1)
    cover, colour = drawing(points, _DOT_SIZE)
    colour = np.asarray(colour)
    if colour.shape[-1] == 1:
        colour = (colour - colour.min()) / np.ptp(colour)
    linear = 1 + cover[..., None] * (colour - 1)
    shown = cv2.pow(np.clip(linear, 0, 1).astype(np.float32), 1 / 2.2).reshape(linear.shape)
    return np.broadcast_to(np.round(255 * shown).astype(np.uint8)[..., ::-1], (*cover.shape, 3))


def _place_picture(figure: Figure, picture: Image, left: float, bottom: float, width: float) -> None:
    axes = figure.add_axes((left / _PAGE[0], bottom / _PAGE[1], width / _PAGE[0], width / _PAGE[1]))
    axes.imshow(picture, interpolation="none", aspect="auto")
    axes.set_axis_off()


def _draw_scale_bar(figure: Figure) -> None:
    """A bar of 100 mm with a step every 10 mm, and how to check it."""
    from matplotlib.patches import Rectangle

    left, bottom, height = (_PAGE[0] - SCALE_BAR) / 2, 0.012, 0.004
    for step in range(10):
        corner = (left + step * SCALE_BAR / 10) / _PAGE[0], bottom / _PAGE[1]
        shade = "black" if step % 2 == 0 else "0.6"
        size = SCALE_BAR / 10 / _PAGE[0], height / _PAGE[1]
        figure.add_artist(Rectangle(corner, *size, facecolor=shade, linewidth=0))
    figure.text(0.5, (bottom + 0.006) / _PAGE[1], _CHECK_TEXT, ha="center", fontsize=7)
    figure.text(0.5, (bottom - 0.005) / _PAGE[1], "100 mm", ha="center", fontsize=7)
