"""Mass, centre of mass, inertia and shape of every hub, from the meshes of the parts that move with it.

A hub is the mass of both faces with its connector or its caps. Strips and active springs rotate in their
sockets: half of their mass is in each socket.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import trimesh

from eldir.core.records import FloatArray
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.wiring import FACES, Face
from eldir_cad.geometry.assembly import Assembly, Placement
from eldir_cad.geometry.shapes import stl
from eldir_cad.kit.specification import Specification

TO_MODEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from the assembly's axes (y up, z to the front) to those of the model (z up, y to the back)."""
BETWEEN_HUBS = ("passive_spring", "spring_end")  # parts that do not move with one hub
_MM = 1e-3

HubPart = Literal["front", "back", "connector"]
"""A part of a hub: the disc of a face, or what joins both."""


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass, centre of mass and inertia tensor of a rigid body, about a hub's centre, in the model's axes."""

    mass: float
    """[kg]"""
    centre: FloatArray
    """Centre of mass from the hub's centre [m], shape (3,)."""
    tensor: FloatArray
    """Inertia about the centre of mass [kg m2], shape (3, 3)."""

    def __add__(self, other: Inertia) -> Inertia:
        mass = self.mass + other.mass
        centre = (self.mass * self.centre + other.mass * other.centre) / mass
        tensor = sum(
            (one.tensor + one.mass * _parallel_axis(one.centre - centre) for one in (self, other)),
            np.zeros((3, 3)),
        )
        return Inertia(mass, centre, tensor)

    @classmethod
    def point(cls, mass: float, position: FloatArray) -> Inertia:
        """A point mass."""
        return cls(mass, position, np.zeros((3, 3)))


def hub_name(hub: int) -> str:
    """Name of a hub's body in MJCF, of its link in URDF and of its STL file. The joints have this name with
    _x, _z and _turn."""
    return f"hub_{hub:02d}"


def hub_inertias(
    assembly: Assembly,
    spec: Specification,
    density: float,
    parameters: BuiltParameters,
    nominal: BuiltParameters,
    ballast: FloatArray,
) -> list[Inertia]:
    """The hubs of a robot with both faces, from the arguments of `disc_inertias`."""
    parts = disc_inertias(assembly, spec, density, parameters, nominal, ballast)
    return [sum(list(own.values())[1:], own["front"]) for own in parts]


def disc_inertias(
    assembly: Assembly,
    spec: Specification,
    density: float,
    parameters: BuiltParameters,
    nominal: BuiltParameters,
    ballast: FloatArray,
) -> list[dict[HubPart, Inertia]]:
    """The discs of every hub on both faces, and its connector if it has one, about the hub's centre.

    `density` [g/cm3] of the resin. `parameters`: those of this robot; its hexagons and connectors weigh as
    much more than their volume says as they differ from `nominal`. `ballast` [kg] on each hub, shape (M,), as
    discs as wide as their holders, half of it on each face.
    """
    scales = {
        "mass": parameters.hexagon / nominal.hexagon,
        "cap": parameters.hexagon / nominal.hexagon,
        "connector": parameters.half_connector / nominal.half_connector,
    }
    parts: list[dict[HubPart, Inertia]] = [{} for _ in assembly.centres]

    def add(hub: int, name: HubPart, inertia: Inertia) -> None:
        own = parts[hub]
        own[name] = own[name] + inertia if name in own else inertia

    for placement in assembly.placements:
        if placement.part in BETWEEN_HUBS:
            continue
        (hub,) = placement.masses
        add(hub, placement.face or "connector", _part_inertia(assembly, placement, hub, density, scales))
    body = assembly.morphology
    for face in FACES:
        across = _MM * face_side(face) * np.array([0.0, spec.springs_at, 0.0])
        for (a, b), active in zip(body.springs.tolist(), body.active, strict=True):
            along = (assembly.centres[b] - assembly.centres[a]) / spec.pitch
            half = (parameters.active_spring if active else parameters.strip) / 2
            for hub, sign in ((a, 1), (b, -1)):
                position = sign * _MM * spec.bulb_radius_at * np.array([along[0], 0.0, along[1]])
                add(hub, face, Inertia.point(half, position + across))
        radius = _MM * spec.holder.across_flats / 2
        for hub, weight in enumerate((ballast / 2).tolist()):
            if weight > 0:
                disc = weight * radius**2 * np.diag([0.25, 0.5, 0.25])
                outside = _MM * face_side(face) * np.array([0.0, spec.outside, 0.0])
                add(hub, face, Inertia(weight, outside, disc))
    return parts


def face_side(face: Face) -> int:
    """Sign of a face's position on the model's y axis, which points to the back."""
    return -1 if face == "front" else 1


def _part_inertia(
    assembly: Assembly, placement: Placement, hub: int, density: float, scales: Mapping[str, float]
) -> Inertia:
    mesh = assembly.parts[placement.part].mesh
    scaled_density = 1e-6 * density * scales[placement.part.split("_")[0]]  # kg/mm3
    rotation = TO_MODEL @ placement.rotation
    offset = TO_MODEL @ (placement.translation - np.array([*assembly.centres[hub], 0.0]))
    centre = rotation @ np.asarray(mesh.center_mass) + offset
    tensor = rotation @ np.asarray(mesh.moment_inertia) @ rotation.T
    return Inertia(scaled_density * float(mesh.volume), _MM * centre, scaled_density * _MM**2 * tensor)


def _parallel_axis(offset: FloatArray) -> FloatArray:
    """Inertia of a unit mass at an offset (parallel axis theorem)."""
    return np.asarray(offset @ offset * np.eye(3) - np.outer(offset, offset))


def hub_shapes(assembly: Assembly) -> dict[int, bytes]:
    """The parts of every hub about its centre, in the model's axes, as binary STL for a viewer [m]."""
    meshes: dict[int, list[trimesh.Trimesh]] = {}
    for placement in assembly.placements:
        if placement.part in BETWEEN_HUBS:
            continue
        (hub,) = placement.masses
        matrix = np.eye(4)
        matrix[:3, :3] = TO_MODEL @ placement.rotation
        matrix[:3, 3] = TO_MODEL @ (placement.translation - np.array([*assembly.centres[hub], 0.0]))
        mesh = assembly.parts[placement.part].mesh.copy()
        mesh.apply_transform(matrix)
        mesh.apply_scale(1e-3)
        meshes.setdefault(hub, []).append(mesh)
    return {hub: stl(_merge(meshes[hub])) for hub in sorted(meshes)}


def _merge(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh with the triangles of all."""
    before = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + first for mesh, first in zip(meshes, before, strict=False)]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)
