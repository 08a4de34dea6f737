"""3MF with the same bytes for the same plate: identifiers from names, one fixed time [mm].

The core specification of the 3MF Consortium with UUIDs of its production extension.
"""

from __future__ import annotations

import io
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import trimesh
from lxml import etree

from eldir.core.records import FloatArray

_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_MODEL = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_UUID = f"{{{_PRODUCTION}}}UUID"
_NAMES = uuid.uuid5(uuid.NAMESPACE_URL, "eldir-plate/1")
_TIME = (1980, 1, 1, 0, 0, 0)  # the earliest that a zip archive can tell


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
        # 3MF writes a row vector times a 4 x 3 matrix: the transpose of what is usual.
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
