"""The robot as a 3D model: glTF binary, in metres, y up."""

from __future__ import annotations

import numpy as np
import trimesh
from trimesh.exchange.gltf import export_glb
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

from cad.geometry.assembly import Assembly
from cad.kit.specification import Specification
from cad.packet.drawing import CONNECTOR, RESIN, coils
from eldir.core.pictures import MARK, MOTOR

_METRE = 1e-3  # of a millimetre


def glb(assembly: Assembly, spec: Specification) -> bytes:
    """A glTF file with each part once and all its places. The same assembly gives the same bytes."""
    scene = trimesh.Scene()
    meshes = {}
    for name, part in assembly.parts.items():
        marked = name.endswith("front") and name in _marked(assembly)
        colour = MARK if marked else CONNECTOR if name == "connector" else RESIN
        meshes[name] = _coloured(part.mesh, colour)
    for i, place in enumerate(assembly.placements):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = place.rotation, place.translation * _METRE
        scene.add_geometry(meshes[place.part], f"{i:04d}", place.part, transform=matrix)
    for i, coil in enumerate(coils(assembly, spec)):
        scene.add_geometry(_coloured(coil, MOTOR), f"coil_{i}", f"coil_{i}")
    return bytes(export_glb(scene, include_normals=False))


def _marked(assembly: Assembly) -> set[str]:
    return {p.part for p in assembly.placements if p.face == "front" and p.masses[0] in assembly.marks}


def _coloured(mesh: trimesh.Trimesh, colour: str) -> trimesh.Trimesh:
    vertices = np.asarray(mesh.vertices) * _METRE
    value = [int(colour[i : i + 2], 16) for i in (1, 3, 5)] + [255]
    material = PBRMaterial(name=colour, baseColorFactor=value, metallicFactor=0.0, roughnessFactor=0.8)
    visual = TextureVisuals(material=material)
    return trimesh.Trimesh(vertices, np.asarray(mesh.faces), process=False, visual=visual)
