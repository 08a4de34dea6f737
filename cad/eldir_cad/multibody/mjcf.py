"""The multibody model as MJCF, MuJoCo's XML: hubs are bodies, strips and coils are tendons.

- A **hub** slides in x and z and rotates about y. Its own drag slows each of these motions.
- A **strip** is a tendon with a soft spring that always pushes with Euler's load, and an upper limit of its
  length. The limit yields with the strip's stiffness in tension. So the strip is stiff up to the load at
  which it buckles, and then pushes with min(K s, PE (1 + s / 2L)), as in the printed scene.
- A **socket** is a tendon from the end of a lever across one hub, many strips long, to the hinge in the other
  hub: its length is the position of that hinge across the socket. An elasto-plastic spring on it is the
  friction of the socket; a limit at both ends of its range is where the strip bends.
- A **coil** is a tendon with a position actuator: the control is the free length, the gain is the stiffness.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from eldir.core.records import FloatArray
from eldir_cad.multibody.hubs import Inertia, hub_name
from eldir_cad.multibody.mjcf_elements import (
    HALF_WIDTH,
    HIDDEN_GROUP,
    LEVER,
    SocketLaw,
    add_assets,
    add_coil_tendon,
    add_element,
    add_keyframe,
    add_options,
    add_parts,
    add_strip_tendon,
    add_world,
    contact_attributes,
    format_numbers,
    hinge_distances,
    parts_name,
    socket_attributes,
    thread_sites,
)
from eldir_cad.multibody.model import CoilSpring, Hub, Multibody, Strip

_POINT_RADIUS = 1e-4  # radius of a hub that is a point [m]


def _add_strip(tendons: Element, bodies: list[Element], model: Multibody, number: int, strip: Strip) -> None:
    name, (a, b) = f"strip_{number:02d}", strip.hubs
    along = _direction(model, a, b)
    hinge = model.socket * along
    ends = _site(bodies[a], f"{name}_a", hinge), _site(bodies[b], f"{name}_b", -hinge)
    inverse_mass = _inverse_mass(model.hubs[a].inertia, hinge, along, model) + _inverse_mass(
        model.hubs[b].inertia, -hinge, along, model
    )
    add_strip_tendon(tendons, name, ends, strip, inverse_mass, model.numerics.contact_time)
    if model.max_rotation is None:
        return
    for end, hub, other, direction in (("a", a, b, along), ("b", b, a, -along)):
        at = model.socket * direction
        across = np.array([-direction[1], direction[0]])
        lever = _site(
            bodies[hub], f"{name}_{end}_lever", at + LEVER * strip.length * across, group=HIDDEN_GROUP
        )
        rotation = add_element(
            tendons,
            "spatial",
            name=f"{name}_{end}_turn",
            group=HIDDEN_GROUP,
            **_socket(model, strip, hub, other, at, direction),
        )
        thread_sites(rotation, lever, ends[1 if end == "a" else 0])


def _socket(
    model: Multibody, strip: Strip, hub: int, other: int, at: FloatArray, direction: FloatArray
) -> dict[str, str]:
    """Friction and bending of a strip in the socket `at` of a hub [N m], as forces on its lever."""
    lever = at + LEVER * strip.length * np.array([-direction[1], direction[0]])
    tip = at + strip.length * direction
    pull = (tip - lever) / np.linalg.norm(tip - lever)
    hinge = -model.socket * direction
    inverse_mass = _inverse_mass(model.hubs[hub].inertia, lever, pull, model) + _inverse_mass(
        model.hubs[other].inertia, hinge, pull, model
    )
    law = SocketLaw(model.socket_friction, model.max_rotation or 0.0, strip.bending)
    return socket_attributes(law, strip.length, inverse_mass, model.numerics.contact_time)


def _add_coil(
    tendons: Element,
    actuators: Element,
    bodies: list[Element],
    model: Multibody,
    number: int,
    coil: CoilSpring,
) -> None:
    name, (a, b) = f"coil_{number}", coil.hubs
    hinge = model.socket * _direction(model, a, b)
    ends = _site(bodies[a], f"{name}_a", hinge), _site(bodies[b], f"{name}_b", -hinge)
    add_coil_tendon(tendons, actuators, name, ends, coil)


def _direction(model: Multibody, a: int, b: int) -> FloatArray:
    """Unit vector from hub a to hub b in the assembled robot."""
    offset = model.hubs[b].position - model.hubs[a].position
    return np.asarray(offset / np.linalg.norm(offset))


def _inverse_mass(inertia: Inertia, at: FloatArray, direction: FloatArray, model: Multibody) -> float:
    """Acceleration along a unit vector by a unit force along it, at a point of a hub [1/kg]."""
    if model.max_rotation is None:
        return 1 / inertia.mass
    arm = at - inertia.centre[[0, 2]]
    return 1 / inertia.mass + (arm[0] * direction[1] - arm[1] * direction[0]) ** 2 / inertia.tensor[1, 1]


def _site(body: Element, name: str, place: FloatArray, group: str = HIDDEN_GROUP) -> str:
    add_element(
        body, "site", name=name, pos=format_numbers([place[0], 0.0, place[1]]), size="0.001", group=group
    )
    return name


def mjcf_text(model: Multibody, name: str = "robot", meshes: Mapping[int, str] | None = None) -> str:
    """The model as the text of an MJCF file; the same model gives the same text.

    `meshes`: files with the shape of each hub, relative to the MJCF file; they are drawn and touch nothing.
    """
    root = Element("mujoco", model=name)
    add_options(root, model)
    assets = add_assets(root, model)
    for hub, file in (meshes or {}).items():
        add_element(assets, "mesh", name=parts_name(hub), file=file)
    world = add_world(root, assets, model, HALF_WIDTH)
    bodies = [_add_hub(world, model, i, hub, i in (meshes or {})) for i, hub in enumerate(model.hubs)]
    tendons = add_element(root, "tendon")
    actuators = add_element(root, "actuator")
    for number, strip in enumerate(model.strips):
        _add_strip(tendons, bodies, model, number, strip)
    for number, coil in enumerate(model.coils):
        _add_coil(tendons, actuators, bodies, model, number, coil)
    joints = sum(1 for _ in world.iter("joint"))
    add_keyframe(root, joints, hinge_distances(model))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_hub(world: Element, model: Multibody, number: int, hub: Hub, has_mesh: bool) -> Element:
    name, inertia = hub_name(number), hub.inertia
    at = [hub.position[0], 0.0, hub.position[1] + model.corner + model.lift]
    body = add_element(world, "body", name=name, pos=format_numbers(at))
    drag = format_numbers([inertia.mass * model.parameters.drag])
    add_element(body, "joint", name=f"{name}_x", type="slide", axis="1 0 0", damping=drag)
    add_element(body, "joint", name=f"{name}_z", type="slide", axis="0 0 1", damping=drag)
    if model.max_rotation is not None:
        rotational_drag = format_numbers([_inertia_about_centre(inertia) * model.parameters.drag])
        joint = {"type": "hinge", "axis": "0 -1 0", "damping": rotational_drag}
        add_element(body, "joint", name=f"{name}_turn", **joint)
    t = inertia.tensor
    full = format_numbers([t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]])
    weight = {"pos": format_numbers(inertia.centre), "mass": format_numbers([inertia.mass])}
    if model.max_rotation is None:
        add_element(body, "inertial", **weight, diaginertia="1e-6 1e-6 1e-6")
    else:
        add_element(body, "inertial", **weight, fullinertia=full)
    contact = contact_attributes(model, hub.friction)
    foot = {"contype": "0", "conaffinity": "1", **contact}
    if model.corner > 0:
        hidden = {"group": "3"} if has_mesh else {}
        add_element(body, "geom", name=f"{name}_foot", type="mesh", mesh="hexagon", **foot, **hidden)
        side = {
            "type": "sphere",
            "size": format_numbers([model.contact_radius]),
            "contype": "2",
            "conaffinity": "2",
        }
        add_element(body, "geom", name=f"{name}_side", group="3", **side, **contact)
    else:
        sphere = {
            "type": "sphere",
            "size": format_numbers([_POINT_RADIUS]),
            "pos": format_numbers([0, 0, _POINT_RADIUS]),
        }
        add_element(body, "geom", name=f"{name}_foot", **sphere, **foot)
    if has_mesh:
        add_parts(body, number)
    return body


def _inertia_about_centre(inertia: Inertia) -> float:
    return float(inertia.tensor[1, 1] + inertia.mass * (inertia.centre[[0, 2]] ** 2).sum())
