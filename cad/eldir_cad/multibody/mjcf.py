"""The multibody model as MJCF, MuJoCo's XML: hubs are bodies, strips and coils are tendons.

- A hub slides in x and z and turns about y. A drag of its own slows each of these.
- Strips and coils are tendons between sites in the hubs: `eldir_cad.multibody.tendons`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from eldir_cad.multibody.elements import add, text_of
from eldir_cad.multibody.hubs import Inertia
from eldir_cad.multibody.model import Hub, Multibody
from eldir_cad.multibody.tendons import add_coil, add_strip

_ROUND = 1e-4  # radius of a hub that is a point [m]


def mjcf(model: Multibody, name: str = "robot", meshes: Mapping[int, str] | None = None) -> str:
    """The model as the text of an MJCF file; the same model gives the same text.

    `meshes`: files with the shape of each hub, relative to the MJCF file; they are seen and touch nothing.
    """
    root = Element("mujoco", model=name)
    _options(root, model)
    assets = add(root, "asset")
    if model.corner > 0:
        angles = np.radians(30 + 60 * np.arange(6))
        ring = [(model.corner * math.cos(a), 0.0, model.corner * math.sin(a)) for a in angles]
        apex = model.corner / 2  # makes it a solid; each corner touches the table at one point
        points = np.array([*ring, (0, apex, 0), (0, -apex, 0)])
        add(assets, "mesh", name="hexagon", vertex=text_of(points.ravel()))
    for hub, file in (meshes or {}).items():
        add(assets, "mesh", name=f"parts_{hub:02d}", file=file)
    world = add(root, "worldbody")
    table = {"type": "plane", "size": "3 1 0.1", "contype": "1", "conaffinity": "0", "condim": "3"}
    add(world, "light", pos="0 -1 2", dir="0 0.4 -1", directional="true")
    add(world, "geom", name="table", rgba=".8 .8 .78 1", friction="0.001", **table)
    bodies = [_hub(world, model, i, hub, i in (meshes or {})) for i, hub in enumerate(model.hubs)]
    tendons = add(root, "tendon")
    actuators = add(root, "actuator")
    for number, strip in enumerate(model.strips):
        add_strip(tendons, bodies, model, number, strip)
    for number, coil in enumerate(model.coils):
        add_coil(tendons, actuators, bodies, model, number, coil)
    _standing(root, model)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _options(root: Element, model: Multibody) -> None:
    n, g = model.numerics, model.gravity
    down = (-g * math.sin(model.tilt), 0.0, g * math.cos(model.tilt))
    add(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true", balanceinertia="false")
    option = {"timestep": text_of([n.step]), "gravity": text_of(down), "impratio": text_of([n.impratio])}
    solver = {"cone": "elliptic", "integrator": "Euler", "solver": "Newton", "tolerance": "1e-10"}
    flags = add(root, "option", **option, **solver)
    add(flags, "flag", autoreset="disable", island="disable")  # one robot is one island
    places = np.array([hub.place for hub in model.hubs])
    middle, extent = (places.min(axis=0) + places.max(axis=0)) / 2, float(np.ptp(places, axis=0).max())
    centre = text_of([middle[0], 0.0, middle[1]])
    add(root, "statistic", center=centre, extent=text_of([extent + 0.05]), meansize=text_of([0.01]))


def _hub(world: Element, model: Multibody, number: int, hub: Hub, seen: bool) -> Element:
    name, inertia = f"hub_{number:02d}", hub.inertia
    at = [hub.place[0], 0.0, hub.place[1] + model.corner]
    body = add(world, "body", name=name, pos=text_of(at))
    drag = text_of([inertia.mass * model.drag])
    add(body, "joint", name=f"{name}_x", type="slide", axis="1 0 0", damping=drag)
    add(body, "joint", name=f"{name}_z", type="slide", axis="0 0 1", damping=drag)
    if model.turn is not None:
        slowed = text_of([_about_centre(inertia) * model.drag])
        turns = {"type": "hinge", "axis": "0 -1 0", "damping": slowed}
        add(body, "joint", name=f"{name}_turn", **turns)
    t = inertia.tensor
    full = text_of([t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]])
    weight = {"pos": text_of(inertia.centre), "mass": text_of([inertia.mass])}
    if model.turn is None:
        add(body, "inertial", **weight, diaginertia="1e-6 1e-6 1e-6")
    else:
        add(body, "inertial", **weight, fullinertia=full)
    n = model.numerics
    contact = {
        "condim": "3", "priority": "1", "friction": text_of([hub.friction]),
        "solref": text_of([n.contact_time, 1.0]), "solimp": text_of([n.impedance, n.impedance, 1e-3, 0.5, 2]),
    }  # fmt: skip
    foot = {"contype": "0", "conaffinity": "1", **contact}
    if model.corner > 0:
        hidden = {"group": "3"} if seen else {}
        add(body, "geom", name=f"{name}_foot", type="mesh", mesh="hexagon", **foot, **hidden)
        side = {"type": "sphere", "size": text_of([model.touching]), "contype": "2", "conaffinity": "2"}
        add(body, "geom", name=f"{name}_side", group="3", **side, **contact)
    else:
        round_ = {"type": "sphere", "size": text_of([_ROUND]), "pos": text_of([0, 0, _ROUND])}
        add(body, "geom", name=f"{name}_foot", **round_, **foot)
    if seen:
        looks = {"type": "mesh", "mesh": f"parts_{number:02d}", "contype": "0", "conaffinity": "0"}
        add(body, "geom", name=f"{name}_parts", group="1", rgba=".35 .45 .6 1", **looks)
    return body


def _standing(root: Element, model: Multibody) -> None:
    """The robot as assembled: every coil is as long as it is then, so that it pulls nowhere."""
    joints = 2 if model.turn is None else 3
    lengths = [
        float(np.linalg.norm(model.hubs[a].place - model.hubs[b].place)) - 2 * model.socket
        for a, b in (coil.hubs for coil in model.coils)
    ]
    keys = add(root, "keyframe")
    zero = text_of(np.zeros(joints * len(model.hubs)))
    add(keys, "key", name="standing", qpos=zero, ctrl=text_of(lengths))


def _about_centre(inertia: Inertia) -> float:
    return float(inertia.tensor[1, 1] + inertia.mass * (inertia.centre[[0, 2]] ** 2).sum())
