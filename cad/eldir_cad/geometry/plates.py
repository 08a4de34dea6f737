"""Plates of a printer: nesting of all parts of a robot, and the 3MF file of a plate [mm].

The same plate gives the same bytes: identifiers from names, one fixed time. The format is the core
specification of the 3MF Consortium, with UUIDs of its production extension.
"""

from __future__ import annotations

import io
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import trimesh
from lxml import etree
from trimesh.path import packing

from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_cad.geometry.parts import Part
from eldir_cad.geometry.shapes import stl
from eldir_cad.kit.printer import Printer

TALL = 20.0
"""Parts above this height [mm] get separate plates: the others print in a third of the time."""
Size = tuple[float, float, float]
"""Width, depth and height of a part in its printing pose [mm]."""
_QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_MODEL = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_UUID = f"{{{_PRODUCTION}}}UUID"
_NAMES = uuid.uuid5(uuid.NAMESPACE_URL, "eldir-plate/1")
_TIME = (1980, 1, 1, 0, 0, 0)  # the earliest of a zip archive


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
        """The plate as 3MF: each part once, with all its copies."""
        return threemf(self.name, {n: p.mesh for n, p in self.parts.items()}, self.items)

    def stl(self) -> bytes:
        """The plate as one STL, for slicers that read no 3MF."""
        return stl(self.mesh())

    def mesh(self) -> trimesh.Trimesh:
        """All parts in their positions, as one mesh."""
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
        # The packing depends on sizes alone, not on names.
        remaining = [name for name in sorted(group, key=lambda n: (sizes[n], n)) for _ in range(counts[name])]
        while remaining:
            extents = np.array([sizes[name][:2] for name in remaining])
            # The packing adds half a spacing on each side.
            room = _printable_volume(printer)[:2] + printer.spacing
            bounds, fits = packing.rectangles(
                extents, size=room, spacing=printer.spacing / 2, iterations=1, rotate=True
            )
            names = [name for name, fit in zip(remaining, fits, strict=True) if fit]
            shifted = bounds + printer.margin - printer.spacing / 2
            plates.append(list(zip(names, shifted, strict=True)))
            remaining = [name for name, fit in zip(remaining, fits, strict=True) if not fit]
    return plates


def _item(name: str, part: Part, place: FloatArray) -> Item:
    fits = np.allclose(place[1] - place[0], part.mesh.extents[:2], atol=1e-5)
    rotation = np.eye(3) if fits else _QUARTER_TURN
    corners = part.mesh.bounds @ rotation.T
    low = np.array([*place[0], 0.0]) - corners.min(axis=0)
    return Item(name, rotation, low)


def _size(part: Part) -> Size:
    x, y, z = part.mesh.extents
    return round(float(x), 6), round(float(y), 6), round(float(z), 6)


def _printable_volume(printer: Printer) -> FloatArray:
    width, depth, height = printer.volume
    return np.array([width - 2 * printer.margin, depth - 2 * printer.margin, height])


def _require_room(name: str, size: Size, printer: Printer) -> None:
    room = _printable_volume(printer)
    x, y, z = size
    if (np.array(size) > room).any() and (np.array([y, x, z]) > room).any():
        raise InputError(
            f"part {name} is larger than the plate of {printer.name}",
            code="part.too-large",
            expected="at most {:g} x {:g} x {:g} mm".format(*room),
            found=f"{x:.1f} x {y:.1f} x {z:.1f} mm",
            remedy="choose a larger printer or a smaller part",
        )


class Item(NamedTuple):
    """One copy of an object on the plate."""

    name: str
    rotation: FloatArray
    """Rotation matrix, shape (3, 3)."""
    translation: FloatArray
    """Translation [mm], shape (3,)."""


def threemf(title: str, meshes: Mapping[str, trimesh.Trimesh], items: Sequence[Item]) -> bytes:
    """A 3MF archive of `items`, each a copy of one of `meshes`."""
    model = etree.Element(f"{{{_CORE}}}model", unit="millimeter", nsmap={None: _CORE, "p": _PRODUCTION})
    etree.SubElement(model, f"{{{_CORE}}}metadata", name="Title").text = title
    resources = etree.SubElement(model, f"{{{_CORE}}}resources")
    identifiers = {}
    for number, (name, mesh) in enumerate(meshes.items(), start=1):
        identifiers[name] = str(number)
        resources.append(_object(name, number, mesh))
    build = etree.SubElement(model, f"{{{_CORE}}}build", {_UUID: _identifier(title)})
    for i, item in enumerate(items):
        # 3MF multiplies a row vector by a 4 x 3 matrix: the transpose of the usual one.
        matrix = np.vstack([np.asarray(item.rotation).T, item.translation])
        values = {
            "objectid": identifiers[item.name],
            "transform": " ".join(f"{v + 0.0:.6g}" for v in matrix.ravel()),
            _UUID: _identifier(f"{title}/{i}"),
        }
        etree.SubElement(build, f"{{{_CORE}}}item", values)
    relations = etree.Element("Relationships", nsmap={None: f"{_PACKAGE}/relationships"})
    etree.SubElement(relations, "Relationship", Target="/3D/3dmodel.model", Id="rel0", Type=_MODEL)
    types = etree.Element("Types", nsmap={None: f"{_PACKAGE}/content-types"})
    for extension, kind in (
        ("rels", "openxmlformats-package.relationships"),
        ("model", "ms-package.3dmanufacturing-3dmodel"),
    ):
        content = f"application/vnd.{kind}+xml"
        etree.SubElement(types, "Default", Extension=extension, ContentType=content)
    return _archive({"[Content_Types].xml": types, "_rels/.rels": relations, "3D/3dmodel.model": model})


def _object(name: str, number: int, mesh: trimesh.Trimesh) -> etree._Element:
    element = etree.Element(
        f"{{{_CORE}}}object", {"id": str(number), "name": name, "type": "model", _UUID: _identifier(name)}
    )
    body = etree.SubElement(element, f"{{{_CORE}}}mesh")
    vertices = etree.SubElement(body, f"{{{_CORE}}}vertices")
    for x, y, z in mesh.vertices.tolist():
        etree.SubElement(vertices, f"{{{_CORE}}}vertex", x=f"{x:.9g}", y=f"{y:.9g}", z=f"{z:.9g}")
    triangles = etree.SubElement(body, f"{{{_CORE}}}triangles")
    for a, b, c in mesh.faces.tolist():
        etree.SubElement(triangles, f"{{{_CORE}}}triangle", v1=str(a), v2=str(b), v3=str(c))
    return element


def _identifier(name: str) -> str:
    return str(uuid.uuid5(_NAMES, name))


def _archive(members: Mapping[str, etree._Element]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name, root in members.items():
            entry = zipfile.ZipInfo(name, _TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, etree.tostring(root, xml_declaration=True, encoding="UTF-8"))
    return file.getvalue()
