"""Markers and reference tags for one robot: the sheets to print, where each goes, and a tag file to start
from."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.core.pictures import GROUND, MOTOR, pdf
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.parameters.printed import BuiltParameters
from eldir_hardware.camera.plane import FieldOfView, TagBoard
from eldir_hardware.markers.registration import DEFAULT_KIND, PALETTE, load_kind
from eldir_hardware.markers.sheet import MAX_TAG_SIDE, marker_pages, tag_pages
from eldir_hardware.markers.squares import square_cells

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NOTES = (
    "Print the sheets at 100 % and check their scale bars. The camera looks at the front face. A marker "
    "sits in the middle of its mass; for a disc there is a seat.",
    "All tags are upright in the plane of the front face, on stiff white card: the lower row at the edge of "
    "the table, along which the robot walks, the upper row on two posts. At 1 m from the camera, 5 mm in "
    "front of this plane or behind it change the scale by 0.5 %.",
    "x counts from the rearmost mass at the start, in the direction of travel; y from the surface of the "
    "table.",
    "Measure to half a millimetre where the centres of the tags really are, and write it into tags.json. "
    "Then calibrate: eldir calibrate plane pictures/ --tags tags.json --out plane.json. Or name the file in "
    "the rig file: camera: {kind: live, tags: tags.json, ...}.",
)


def starter_board(design: Design, scale: float) -> TagBoard:
    """Places for the reference tags of a robot that walks up to 1.3 body lengths, to a millimetre. `scale`:
    lengths of the printed robot by those of the design."""
    board = TagBoard.around(FieldOfView.around(_positions(design, scale)))
    return TagBoard.at(np.round(board.centres, 3), min(round(board.side_m, 3), MAX_TAG_SIDE))


def placement_files(design: Design, scale: float, kind: str = DEFAULT_KIND) -> dict[str, bytes]:
    """`markers.pdf` and `tags.json` of a robot's packet, with markers of this kind. `scale` as for
    `starter_board`. Raises `InputError` for a kind that is not installed."""
    board = starter_board(design, scale)

    def pages() -> Iterator[Figure]:
        yield _draw_placement(design, scale, board, kind == DEFAULT_KIND)
        yield from marker_pages(load_kind(kind), design.marks.tolist())
        yield from tag_pages(board.dictionary, len(board.ids), board.side_m)

    text = json.dumps(board.to_json(), indent=1) + "\n"
    return {"markers.pdf": pdf(pages()), "tags.json": text.encode()}


def _positions(design: Design, scale: float) -> FloatArray:
    """Places of the masses [m], the rearmost at x = 0, the lowest at y = 0, shape (M, 2)."""
    at = design.morphology.positions
    return np.asarray((at - at.min(axis=0)) * scale)


def _draw_placement(design: Design, scale: float, board: TagBoard, in_colour: bool) -> Figure:
    """Robot and tags in the plane of motion, with the place of each."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.7, 8.3))
    figure.text(0.03, 0.965, "Where markers and tags go", fontsize=14, weight="bold", va="top")
    _draw_plane(figure.add_axes((0.08, 0.37, 0.89, 0.55)), design, scale, board, in_colour)
    half = -(-len(board.tags) // 2)
    for column, tags in enumerate((board.tags[:half], board.tags[half:])):
        lines = ["tag      x [mm]   y [mm]"]
        lines += [f"{tag.id:3d} {1e3 * tag.x_m:11.0f} {1e3 * tag.y_m:8.0f}" for tag in tags]
        style: dict[str, Any] = {"fontsize": 8, "va": "top", "family": "monospace", "linespacing": 1.5}
        figure.text(0.04 + 0.19 * column, 0.29, "\n".join(lines), **style)
    marks = zip(PALETTE, design.marks.tolist(), strict=False)
    figure.text(
        0.42, 0.29, "\n".join(["marker   mass", *(f"{name:7s} {mass:5d}" for name, mass in marks)]),
        fontsize=8, va="top", family="monospace", linespacing=1.5,
    )  # fmt: skip
    notes = "\n\n".join(textwrap.fill(note, 80) for note in _NOTES)
    figure.text(0.56, 0.29, notes, fontsize=7.5, va="top", linespacing=1.3)
    return figure


def _draw_plane(axes: Axes, design: Design, scale: float, board: TagBoard, in_colour: bool) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Circle

    body, centres, side = design.morphology, 1e3 * _positions(design, scale), 1e3 * board.side_m
    centres[:, 1] += 1e3 * BuiltParameters().with_hubs().corner  # it stands on the corners of its masses
    ends = centres[body.springs]
    axes.add_collection(LineCollection(list(ends[~body.active]), colors="#888888", linewidths=1.0))
    axes.add_collection(LineCollection(list(ends[body.active]), colors=MOTOR, linewidths=3.0))
    axes.plot(*centres.T, "o", color="#444444", ms=3)
    for (name, colour), mass in zip(PALETTE.items(), design.marks.tolist(), strict=False):
        fill = np.array(colour) / 255 if in_colour else "white"
        axes.add_patch(Circle(centres[mass], 7.0, fc=fill, ec="black", lw=0.8, zorder=4))
        axes.annotate(name, centres[mass], (7, 5), textcoords="offset points", fontsize=8, weight="bold")
    for tag in board.tags:
        x, y = 1e3 * tag.x_m, 1e3 * tag.y_m
        edges = (x - side / 2, x + side / 2, y - side / 2, y + side / 2)
        cells = square_cells(board.dictionary, tag.id)
        axes.imshow(cells, cmap="gray", extent=edges, interpolation="none", zorder=2)
        axes.text(x + side / 2 + 4, y, str(tag.id), va="center", fontsize=11, weight="bold")
    axes.axhline(0.0, color=GROUND, lw=2.0)
    axes.set_aspect("equal")
    places = 1e3 * board.centres
    axes.set_xlim(places[:, 0].min() - side, places[:, 0].max() + side)
    axes.set_ylim(places[:, 1].min() - 0.7 * side, places[:, 1].max() + 0.7 * side)
    axes.set_xlabel("x [mm], travel to the right; brown: surface of the table; each tag with its number")
    axes.set_ylabel("y [mm]")
    axes.spines[["top", "right"]].set_visible(False)
