"""Nesting: all parts of a robot on few plates of a printer [mm]."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import trimesh
from trimesh.path import packing

from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_cad.geometry.parts import Part
from eldir_cad.geometry.shapes import stl
from eldir_cad.geometry.threemf import Item, threemf
from eldir_cad.kit.printer import Printer

TALL = 20.0  # parts above this height [mm] get plates of their own: the others print in a third of the time
Size = tuple[float, float, float]
"""Width, depth and height of a part in the pose it is printed in."""
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Plate:
    """A plate: one print job."""

    name: str
    parts: Mapping[str, Part]
    """The parts on the plate."""
    items: tuple[Item, ...]

    @property
    def height(self) -> float:
        """Height of the tallest part."""
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
    sizes = {name: _size(part) for name, part in parts.items()}
    plates: list[Plate] = []
    for places in _arrange(sizes, counts, printer):
        items = tuple(_item(name, parts[name], place) for name, place in places)
        used = {name: parts[name] for name in sorted({item.name for item in items})}
        plates.append(Plate(f"plate_{len(plates) + 1:02d}", used, items))
    return plates


def count_plates(sizes: Mapping[str, Size], counts: Mapping[str, int], printer: Printer) -> int:
    """The number of plates that parts of these sizes need."""
    return len(_arrange(sizes, counts, printer))


def _arrange(
    sizes: Mapping[str, Size], counts: Mapping[str, int], printer: Printer
) -> list[list[tuple[str, FloatArray]]]:
    """For each plate, the names and corners [mm], shape (2, 2), of its parts."""
    for name, size in sizes.items():
        _require_room(name, size, printer)
    tall = {name for name, size in sizes.items() if size[2] > TALL}
    plates = []
    for group in (set(sizes) - tall, tall):
        # Parts of one size are alike to the packing, whatever their names.
        waiting = [name for name in sorted(group, key=lambda n: (sizes[n], n)) for _ in range(counts[name])]
        while waiting:
            extents = np.array([sizes[name][:2] for name in waiting])
            room = _room(printer)[:2] + printer.spacing  # the packing keeps half a spacing on each side
            bounds, fits = packing.rectangles(
                extents, size=room, spacing=printer.spacing / 2, iterations=1, rotate=True
            )
            names = [name for name, fit in zip(waiting, fits, strict=True) if fit]
            shifted = bounds + printer.margin - printer.spacing / 2
            plates.append(list(zip(names, shifted, strict=True)))
            waiting = [name for name, fit in zip(waiting, fits, strict=True) if not fit]
    return plates


def _item(name: str, part: Part, place: FloatArray) -> Item:
    fits = np.allclose(place[1] - place[0], part.mesh.extents[:2], atol=1e-5)
    rotation = np.eye(3) if fits else _QUARTER
    corners = part.mesh.bounds @ rotation.T
    low = np.array([*place[0], 0.0]) - corners.min(axis=0)
    return Item(name, rotation, low)


def _size(part: Part) -> Size:
    x, y, z = part.mesh.extents
    return round(float(x), 6), round(float(y), 6), round(float(z), 6)


def _room(printer: Printer) -> FloatArray:
    width, depth, height = printer.volume
    return np.array([width - 2 * printer.margin, depth - 2 * printer.margin, height])


def _require_room(name: str, size: Size, printer: Printer) -> None:
    room = _room(printer)
    x, y, z = size
    if (np.array(size) > room).any() and (np.array([y, x, z]) > room).any():
        raise InputError(
            f"part {name} is larger than the plate of {printer.name}",
            code="part.too-large",
            expected="at most {:g} x {:g} x {:g} mm".format(*room),
            found=f"{x:.1f} x {y:.1f} x {z:.1f} mm",
            remedy="choose a larger printer or a smaller part",
        )
