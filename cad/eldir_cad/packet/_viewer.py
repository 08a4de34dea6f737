"""The robot as a page with a 3D view in one file: its parts step by step, and the number of a part on touch.

The viewer is three.js as trimesh ships it; the page needs no network.
"""

from __future__ import annotations

import json
from importlib import resources

import numpy as np
from trimesh.scene.cameras import Camera
from trimesh.viewer import scene_to_html

from eldir.core.pictures import MOTOR
from eldir.parameters.wiring import FACES, Wiring
from eldir_cad.geometry.assembly import Assembly, Placement
from eldir_cad.kit.specification import Specification
from eldir_cad.packet._drawing import coil, colour_mesh, scene_of_parts

_STEPS = (
    "masses of the front face, floors down",
    "passive springs of the front face",
    "coils of the front face on their spring ends",
    "connectors, and caps on masses with six springs",
    "masses of the back face, with its springs, coils and caps",
    "ballast holders",
)
_FRONT_STEPS = {"passive_spring": 1, "spring_end": 2, "cap": 3, "ballast_holder": 5}
_CONNECTORS, _COILS, _BACK = 3, 2, 4
_VIEW = np.radians([-20.0, 205.0, 0.0])  # from behind and above: the front face lies on the table


def assembly_page(assembly: Assembly, spec: Specification, connections: Wiring) -> str:
    """The page as HTML. The same assembly gives the same text."""
    scene = scene_of_parts(assembly)
    parts: dict[str, dict[str, object]] = {
        f"{i:04d}": {"step": _step(place), "name": _describe(assembly, place)}
        for i, place in enumerate(assembly.placements)
    }
    body = assembly.morphology
    channels = {(c.spring, face): c.channel for c in connections for face in c.faces}
    for motor, ends in enumerate(assembly.centres[body.springs[body.active]]):
        for face in FACES:
            name = f"coil{motor}{face}"
            (mesh,) = coil(ends, face, spec, pieces=1)
            scene.add_geometry(colour_mesh(mesh, MOTOR), name, name)
            step = _COILS if face == "front" else _BACK
            text = f"coil of motor S{motor}, {face} face: relay channel {channels[motor, face]}"
            parts[name] = {"step": step, "name": text}
    scene.camera = Camera("camera", resolution=(1200, 800), fov=(50, 35))
    scene.set_camera(angles=_VIEW, distance=1.3 * scene.scale, center=scene.centroid)
    last = max(int(str(part["step"])) for part in parts.values())
    steps = resources.files("eldir_cad.packet").joinpath("data", "steps.html").read_text("utf-8")
    steps = steps.replace("$STEPS", json.dumps(_STEPS[: last + 1])).replace("$PARTS", json.dumps(parts))
    page = str(scene_to_html(scene)).replace("trimesh: threejs viewer", "Assembly")
    return page.replace("</body>", steps + "</body>")


def _step(place: Placement) -> int:
    """The step in which a part is added, from 0."""
    if place.part == "connector":
        return _CONNECTORS
    if place.face == "back" and place.part != "ballast_holder":
        return _BACK
    return _FRONT_STEPS.get(place.part, 0)


def _describe(assembly: Assembly, place: Placement) -> str:
    """Such as "passive spring between masses 3 and 5, front face (passive_spring.stl)"."""
    part = assembly.parts[place.part]
    if part.name.startswith("mass"):
        text = part.purpose
    else:
        where = " and ".join(map(str, place.masses))
        between = f"between masses {where}" if len(place.masses) > 1 else f"at mass {where}"
        text = f"{part.purpose} {between}" + (f", {place.face} face" if place.face else "")
    return f"{text} ({part.name}.stl)"
