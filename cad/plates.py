"""Nesting: all parts of a robot on as few plates of a printer as its packing finds [mm]."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import trimesh
from trimesh.path import packing

from cad.parts import Part
from cad.shapes import stl
from cad.specification import Printer
from cad.threemf import Item, threemf
from eldir.errors import InputError
from eldir.frozen import FloatArray

TALL = 20.0  # parts above this height [mm] get plates of their own: the others print in a third of the time
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Plate:
    """One print job."""

    name: str
    parts: Mapping[str, Part]
    """Those that lie on it."""
    items: tuple[Item, ...]

    @property
    def height(self) -> float:
        """Of the tallest part."""
        return max(float(p.mesh.extents[2]) for p in self.parts.values())

    def threemf(self) -> bytes:
        """The plate as 3MF: each part once, with all its places."""
        return threemf(self.name, {n: p.mesh for n, p in self.parts.items()}, self.items)

    def stl(self) -> bytes:
        """The plate as one STL, for slicers that read nothing else."""
        return stl(self.mesh())

    def mesh(self) -> trimesh.Trimesh:
        """All parts in their places, as one mesh."""
        copies = []
        for item in self.items:
            copy = self.parts[item.name].mesh.copy()
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = item.rotation, item.translation
            copies.append(copy.apply_transform(matrix))
        starts = [0, *np.cumsum([len(c.vertices) for c in copies])[:-1].tolist()]
        faces = [c.faces + start for c, start in zip(copies, starts, strict=True)]
        vertices = np.concatenate([c.vertices for c in copies])
        return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)


def nest(parts: Mapping[str, Part], counts: Mapping[str, int], printer: Printer) -> list[Plate]:
    """`counts` of each part on plates, with the printer's spacing and margin; flat parts first."""
    for part in parts.values():
        _require_room(part, printer)
    tall = {n for n, p in parts.items() if p.mesh.extents[2] > TALL}
    plates: list[Plate] = []
    for group in (sorted(set(parts) - tall), sorted(tall)):
        waiting = [name for name in group for _ in range(counts[name])]
        while waiting:
            placed = _fill(parts, waiting, printer)
            items = tuple(item for item in placed if item is not None)
            used = {name: parts[name] for name in sorted({item.name for item in items})}
            plates.append(Plate(f"plate_{len(plates) + 1:02d}", used, items))
            waiting = [name for name, item in zip(waiting, placed, strict=True) if item is None]
    return plates


def _fill(parts: Mapping[str, Part], waiting: list[str], printer: Printer) -> list[Item | None]:
    """The place of each waiting part on one plate, None for those that it does not hold."""
    extents = np.array([parts[name].mesh.extents[:2] for name in waiting])
    size = _room(printer)[:2] + printer.spacing  # the packing keeps half a spacing on each side
    bounds, inserted = packing.rectangles(
        extents, size=size, spacing=printer.spacing / 2, iterations=1, rotate=True
    )
    shift = printer.margin - printer.spacing / 2
    places = iter(bounds + shift)
    return [
        _item(name, parts[name], next(places)) if is_in else None
        for name, is_in in zip(waiting, inserted, strict=True)
    ]


def _item(name: str, part: Part, place: FloatArray) -> Item:
    fits = np.allclose(place[1] - place[0], part.mesh.extents[:2], atol=1e-6)
    rotation = np.eye(3) if fits else _QUARTER
    corners = part.mesh.bounds @ rotation.T
    low = np.array([*place[0], 0.0]) - corners.min(axis=0)
    return Item(name, rotation, low)


def _room(printer: Printer) -> FloatArray:
    width, depth, height = printer.volume
    return np.array([width - 2 * printer.margin, depth - 2 * printer.margin, height])


def _require_room(part: Part, printer: Printer) -> None:
    room = _room(printer)
    x, y, z = part.mesh.extents
    turned = np.array([y, x, z])
    if (part.mesh.extents > room).any() and (turned > room).any():
        raise InputError(
            f"part {part.name} is larger than the plate of {printer.name}",
            expected="at most {:g} x {:g} x {:g} mm".format(*room),
            found=f"{x:.1f} x {y:.1f} x {z:.1f} mm",
            remedy="choose a larger printer or a smaller part",
        )
