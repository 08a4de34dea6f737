"""Pictures for the workshop: the robot, also as a 3D model, and the numbered map of both faces."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, RegularPolygon
from trimesh.exchange.gltf import export_glb
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

from eldir.core.pictures import MARK, MOTOR
from eldir.core.records import FloatArray
from eldir.parameters.wiring import FACES, Face, Wiring, wiring_digest
from eldir_cad.geometry.assembly import Assembly, Placement
from eldir_cad.kit.specification import Specification
from eldir_cad.packet._layout import Sign, cover_page, draw_legend

ColouredMesh = tuple[trimesh.Trimesh, str]
_RESIN, CONNECTOR = "#9db7c9", "#d9c48f"
_COIL_PIECES = 12
_MARGINS = np.array([44.0, 60.0])  # around the masses of a face on the map [mm]
_PAGE_RATIO = 1.95  # width to height, below which two faces are larger side by side than one above the other
_SMALL = 0.026  # size of a mass in the legend
_STRIP_LINE: dict[str, Any] = {"colors": "#888888", "linewidths": 1.2}
_MOTOR_LINE: dict[str, Any] = {"colors": MOTOR, "linewidths": 4}
_LIGHT = np.array([0.35, 0.55, 0.75]) / np.linalg.norm([0.35, 0.55, 0.75])
_MM = 1e-3  # [m]


def draw_robot(assembly: Assembly, spec: Specification) -> Figure:
    """The assembled robot, seen from its front face, a little from above and from the right."""
    solids: list[ColouredMesh] = []
    for place in assembly.placements:
        mesh = assembly.parts[place.part].mesh.copy()
        if place.part == "spring_end":  # the covered part would be drawn over the coil
            mesh.update_faces(mesh.triangles_center[:, 2] > spec.fitting.stud_length - 1e-3)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = place.rotation, place.translation
        marked = place.face == "front" and place.part.startswith("mass") and place.masses[0] in assembly.marks
        colour = MARK if marked else CONNECTOR if place.part == "connector" else _RESIN
        solids.append((mesh.apply_transform(matrix), colour))
    solids += [(coil, MOTOR) for coil in _coils(assembly, spec)]
    figure = Figure(figsize=(9, 6))
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.93))
    _draw_shaded(axes, solids, turn=-28, tilt=22)
    return figure


def draw_assembly_map(assembly: Assembly, connections: Wiring, ballast: int | None = None) -> Figure:
    """Both faces with the number of every mass, motors with their channels, connectors, m1 to m5, and the
    mass with the ballast."""
    figure = Figure(figsize=(11.7, 8.3))
    figure.text(0.03, 0.965, "Assembly map", fontsize=14, weight="bold", va="top")
    digest = f"wiring {wiring_digest(connections)[:8]}"  # manifest.json has all digits
    figure.text(0.97, 0.965, digest, fontsize=8, va="top", ha="right")
    wide, high = np.ptp(assembly.centres, axis=0) + _MARGINS
    beside = wide / high < _PAGE_RATIO  # the faces are then larger side by side
    for i, face in enumerate(FACES):
        place = (0.02 + 0.49 * i, 0.15, 0.47, 0.72) if beside else (0.03, 0.53 - 0.38 * i, 0.94, 0.34)
        channels = {c.spring: c.channel for c in connections if face in c.faces}
        _draw_face(figure.add_axes(place), assembly, face, channels, ballast)
    draw_legend(cover_page(figure, 0.14), _LEGEND, 2.6, columns=3)
    return figure


def _draw_face(
    axes: Axes,
    assembly: Assembly,
    face: Face,
    channels: dict[int, int],
    ballast: int | None,
) -> None:
    body = assembly.morphology
    centres = assembly.centres * ([1, 1] if face == "front" else [-1, 1])
    lines = centres[body.springs]
    axes.add_collection(LineCollection(list(lines[~body.active]), **_STRIP_LINE))
    axes.add_collection(LineCollection(list(lines[body.active]), **_MOTOR_LINE))
    for motor, (x, y) in enumerate(lines[body.active].mean(axis=1)):
        _label_motor(axes, x, y, f"S{motor} / {channels[motor]}")
    degree = np.bincount(body.springs.ravel(), minlength=len(centres))
    marks = {int(m): f"m{i + 1}" for i, m in enumerate(assembly.marks)} if face == "front" else {}
    for i, (x, y) in enumerate(centres):
        _draw_mass(axes, x, y, CONNECTOR if degree[i] < 6 else "white", str(i))
        if i == ballast:
            axes.text(x, y - 19, "ballast", fontsize=8, weight="bold", ha="center", zorder=4)
        if i in marks:
            _draw_seat(axes, x, y)
            axes.text(x, y + 15, marks[i], fontsize=8, weight="bold", color=MARK, ha="center", zorder=4)
    axes.set_aspect("equal")
    axes.set_xlim(centres[:, 0].min() - _MARGINS[0] / 2, centres[:, 0].max() + _MARGINS[0] / 2)
    axes.set_ylim(centres[:, 1].min() - 24, centres[:, 1].max() + _MARGINS[1] - 24)
    axes.axis("off")
    direction = "travel to the right" if face == "front" else "travel to the left"
    under = ("one line", "two lines")[FACES.index(face)]
    axes.set_title(f"{face} face, seen from outside ({direction}); {under} under the numbers", fontsize=9)


def _label_motor(axes: Axes, x: float, y: float, text: str) -> None:
    frame = {"fc": "white", "ec": MOTOR, "pad": 1.5, "lw": 0.6}
    style: dict[str, Any] = {"fontsize": 8, "weight": "bold", "color": MOTOR, "ha": "center", "va": "center"}
    axes.text(x, y, text, bbox=frame, zorder=4, **style)


def _draw_mass(axes: Axes, x: float, y: float, colour: str, number: str, size: float = 1.0) -> None:
    axes.add_patch(RegularPolygon((x, y), 6, radius=9.5 * size, fc=colour, ec="black", lw=0.8, zorder=3))
    axes.text(x, y, number, fontsize=7.5, ha="center", va="center", zorder=4)


def _draw_seat(axes: Axes, x: float, y: float, size: float = 1.0) -> None:
    axes.add_patch(Circle((x, y), radius=13 * size, fill=False, ec=MARK, lw=2, zorder=3))


_LEGEND: tuple[tuple[Sign, str], ...] = (
    (
        lambda axes, x, y: _draw_mass(axes, x, y, CONNECTOR, "3", _SMALL),
        "mass 3, with a connector to the other face",
    ),
    (
        lambda axes, x, y: _draw_mass(axes, x, y, "white", "3", _SMALL),
        "mass 3, with six springs, so with a cap",
    ),
    (lambda axes, x, y: _draw_seat(axes, x, y, _SMALL), "m1 to m5: seat of a disc, front face alone"),
    (
        lambda axes, x, y: axes.add_collection(LineCollection([[(x - 0.7, y), (x + 0.7, y)]], **_STRIP_LINE)),
        "passive spring",
    ),
    (
        lambda axes, x, y: axes.add_collection(LineCollection([[(x - 0.7, y), (x + 0.7, y)]], **_MOTOR_LINE)),
        "motor: shape-memory spring on two spring ends",
    ),
    (lambda axes, x, y: _label_motor(axes, x, y, "S0 / 1"), "number of the motor / its relay channel"),
)


def _coils(assembly: Assembly, spec: Specification) -> list[trimesh.Trimesh]:
    """The shape-memory springs as rods in short pieces, which can be sorted by depth."""
    body = assembly.morphology
    motors = assembly.centres[body.springs[body.active]]
    return [piece for ends in motors for face in FACES for piece in coil(ends, face, spec)]


def coil(
    ends: FloatArray, face: Face, spec: Specification, pieces: int = _COIL_PIECES
) -> list[trimesh.Trimesh]:
    """A shape-memory spring between masses with these centres [mm], shape (2, 2), as rods end to end."""
    a, b = ends
    along = (b - a) / np.linalg.norm(b - a) * spec.coil_seat
    z = spec.springs_at if face == "front" else -spec.springs_at
    turns = np.linspace([*(a + along), z], [*(b - along), z], pieces + 1)
    radius = spec.coil.outer_diameter / 2
    return [trimesh.creation.cylinder(radius, segment=rod, sections=16) for rod in pairwise(turns)]


def placed(assembly: Assembly, place: Placement) -> trimesh.Trimesh:
    """A copy of a part where it is in the robot [mm]."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = place.rotation, place.translation
    mesh = assembly.parts[place.part].mesh.copy()
    mesh.apply_transform(matrix)
    return mesh


def _draw_shaded(axes: Axes, solids: Sequence[ColouredMesh], turn: float, tilt: float) -> None:
    """Draw solids in parallel projection, the farthest triangles first."""
    view = _view_rotation(np.radians(turn), np.radians(tilt))
    corners, colours = [], []
    for mesh, colour in solids:
        normals = mesh.face_normals @ view.T
        facing = normals[:, 2] > 0
        corners.append((mesh.triangles[facing] @ view.T).reshape(-1, 3, 3))
        brightness = 0.4 + 0.6 * np.clip(normals[facing] @ _LIGHT, 0, 1)
        colours.append(brightness[:, None] * _rgb(colour))
    points, shades = np.concatenate(corners), np.concatenate(colours)
    order = np.argsort(points[:, :, 2].mean(axis=1), kind="stable")
    outlines: Any = points[order, :, :2]  # as an array: ten times faster than as a list
    axes.add_collection(PolyCollection(outlines, facecolors=shades[order], antialiaseds=False))
    extent = points[..., :2].reshape(-1, 2)
    low, high = extent.min(axis=0), extent.max(axis=0)
    pad = 0.03 * (high - low).max()
    axes.set_xlim(low[0] - pad, high[0] + pad)
    axes.set_ylim(low[1] - pad, high[1] + pad)
    axes.set_aspect("equal")
    axes.axis("off")


def _view_rotation(turn: float, tilt: float) -> FloatArray:
    """Rotation from the world to the screen (right, up, towards the viewer): about y, then about x."""
    c, s = np.cos(turn), np.sin(turn)
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    c, s = np.cos(tilt), np.sin(tilt)
    return np.asarray(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ about_y)


def _rgb(colour: str) -> Any:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255


def robot_glb(assembly: Assembly, spec: Specification) -> bytes:
    """The robot as a binary glTF file, in metres, y up, with each part once and all its placements.
    The same assembly gives the same bytes."""
    scene = scene_of_parts(assembly)
    for i, rod in enumerate(_coils(assembly, spec)):
        scene.add_geometry(colour_mesh(rod, MOTOR), f"coil_{i}", f"coil_{i}")
    return bytes(export_glb(scene, include_normals=False))


def scene_of_parts(assembly: Assembly) -> trimesh.Scene:
    """Each part once, in metres, and all its placements, whose nodes are their numbers of four digits."""
    scene = trimesh.Scene()
    meshes = {}
    for name, part in assembly.parts.items():
        marked = name.endswith("front") and name in _marked_parts(assembly)
        colour = MARK if marked else CONNECTOR if name == "connector" else _RESIN
        meshes[name] = colour_mesh(part.mesh, colour)
    for i, place in enumerate(assembly.placements):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = place.rotation, place.translation * _MM
        scene.add_geometry(meshes[place.part], f"{i:04d}", place.part, transform=matrix)
    return scene


def _marked_parts(assembly: Assembly) -> set[str]:
    return {p.part for p in assembly.placements if p.face == "front" and p.masses[0] in assembly.marks}


def colour_mesh(mesh: trimesh.Trimesh, colour: str) -> trimesh.Trimesh:
    """The mesh in metres, in a colour."""
    vertices = np.asarray(mesh.vertices) * _MM
    value = [int(colour[i : i + 2], 16) for i in (1, 3, 5)] + [255]
    material = PBRMaterial(name=colour, baseColorFactor=value, metallicFactor=0.0, roughnessFactor=0.8)
    visual = TextureVisuals(material=material)
    return trimesh.Trimesh(vertices, np.asarray(mesh.faces), process=False, visual=visual)
