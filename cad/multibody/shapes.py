"""Shapes of the hubs for a viewer: the printed parts that move with each hub, as binary STL [m]."""

from __future__ import annotations

import numpy as np
import trimesh

from cad.geometry.assembly import Assembly
from cad.geometry.shapes import stl
from cad.multibody.hubs import TO_MODEL, TURNING


def hub_shapes(assembly: Assembly) -> dict[int, bytes]:
    """The parts of every hub about its centre, in the model's axes."""
    found: dict[int, list[trimesh.Trimesh]] = {}
    for placement in assembly.placements:
        if placement.part in TURNING:
            continue
        (hub,) = placement.masses
        matrix = np.eye(4)
        matrix[:3, :3] = TO_MODEL @ placement.rotation
        matrix[:3, 3] = TO_MODEL @ (placement.translation - np.array([*assembly.centres[hub], 0.0]))
        mesh = assembly.parts[placement.part].mesh.copy()
        mesh.apply_transform(matrix)
        mesh.apply_scale(1e-3)
        found.setdefault(hub, []).append(mesh)
    return {hub: stl(_together(found[hub])) for hub in sorted(found)}


def _together(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """All triangles of several meshes."""
    before = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + first for mesh, first in zip(meshes, before, strict=False)]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)
