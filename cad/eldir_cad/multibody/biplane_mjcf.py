"""The robot with two faces as MJCF.

As `eldir_cad.multibody.mjcf`, for each face by itself, with these differences:

- A **hub** moves in six directions: joints x, y and z, and yaw, roll and turn about z, x and y, in this
  order, so that yaw is unlimited and turn is about the hub's own axis. Discs without a connector are two
  bodies.
- A **connector** that yields is three joints between its discs. Equality constraints hold them; they yield by
  their impedance as limits do.
- A **socket** has a second lever, to the back, for rotations of the strip out of its plane.
- A **disc** stands on the corners of its outer edge. It meets others as a sphere.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from eldir.core.records import FloatArray
from eldir.parameters.wiring import FACES, Face
from eldir_cad.multibody.biplane import Biplane, FaceParts
from eldir_cad.multibody.discs import DiscPair
from eldir_cad.multibody.hubs import Inertia, face_side, hub_name
from eldir_cad.multibody.mjcf_elements import (
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
    limit_attributes,
    parts_name,
    socket_attributes,
    thread_sites,
)
from eldir_cad.multibody.model import Strip

HUB_JOINTS = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1", "yaw": "0 0 1", "roll": "1 0 0", "turn": "0 -1 0"}
"""Joints of a hub with their axes; the first three slide."""
YIELDING_JOINTS = ("x", "z", "turn")
"""Joints of a back disc whose connector yields."""
_HALF_WIDTH = 0.5  # of a terrain [m]
_LATERAL = np.array([0.0, 1.0, 0.0])

Bodies = dict[tuple[int, Face], Element]


def disc_name(hub: int, face: Face) -> str:
    """Name of the site in a disc's middle, and with _foot of the geom on which it stands."""
    return f"{hub_name(hub)}_{face}"


def biplane_mjcf(model: Biplane, name: str = "robot", meshes: Mapping[int, str] | None = None) -> str:
    """The model as the text of an MJCF file; the same model gives the same text.

    `meshes`: as of `mjcf_text`; hubs whose discs have no connector are drawn without.
    """
    root = Element("mujoco", model=name)
    add_options(root, model.plane, model.side_tilt)
    assets = add_assets(root, model.plane)
    drawn = {hub: file for hub, file in (meshes or {}).items() if model.discs[hub].joining != "apart"}
    for hub, file in drawn.items():
        add_element(assets, "mesh", name=parts_name(hub), file=file)
    world = add_world(root, assets, model.plane, _HALF_WIDTH)
    tendons, equality = Element("tendon"), Element("equality")
    actuators = Element("actuator")
    bodies: Bodies = {}
    for hub, pair in enumerate(model.discs):
        _add_hub(world, equality, bodies, model, hub, pair, hub in drawn)
    for face, parts in zip(FACES, model.faces, strict=True):
        for number, strip in enumerate(parts.strips):
            _add_strip(tendons, bodies, model, number, face, strip)
    for number in range(len(model.front.coils)):
        for face, parts in zip(FACES, model.faces, strict=True):
            coil = parts.coils[number]
            ends = _hinges(bodies, model, f"coil_{number}_{face}", face, coil.hubs)[0]
            add_coil_tendon(tendons, actuators, f"coil_{number}_{face}", ends, coil)
    root.extend([tendons, equality, actuators])
    joints = sum(1 for _ in world.iter("joint"))
    add_keyframe(root, joints, np.repeat(hinge_distances(model.plane), len(FACES)))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_hub(
    world: Element,
    equality: Element,
    bodies: Bodies,
    model: Biplane,
    hub: int,
    pair: DiscPair,
    has_mesh: bool,
) -> None:
    plane, name = model.plane, hub_name(hub)
    x, y = plane.hubs[hub].position
    place = format_numbers([x, 0.0, y + plane.corner + plane.lift])
    front = add_element(world, "body", name=name, pos=place)
    if pair.joining == "rigid":
        _add_joints(front, name, pair.whole, plane.parameters.drag)
        back = front
    else:
        _add_joints(front, name, pair.front, plane.parameters.drag)
        if pair.joining == "apart":
            back = add_element(world, "body", name=f"{name}_back", pos=place)
            _add_joints(back, f"{name}_back", pair.back, plane.parameters.drag)
        else:
            back = add_element(front, "body", name=f"{name}_back")
            _add_connector(back, equality, model, name, pair)
    for face, body, parts in zip(FACES, (front, back), model.faces, strict=True):
        _add_disc(body, model, hub, face, parts, has_mesh)
        bodies[hub, face] = body
    if has_mesh:
        add_parts(front, hub)


def _add_joints(body: Element, name: str, inertia: Inertia, drag: float) -> None:
    """Six joints, each slowed by the hub's drag, and its mass."""
    turning = np.diag(inertia.tensor) + inertia.mass * (inertia.centre @ inertia.centre - inertia.centre**2)
    resisting = [inertia.mass] * 3 + [turning[2], turning[0], turning[1]]
    for (joint, axis), inertial in zip(HUB_JOINTS.items(), resisting, strict=True):
        kind = "slide" if joint in "xyz" else "hinge"
        damping = format_numbers([inertial * drag])
        add_element(body, "joint", name=f"{name}_{joint}", type=kind, axis=axis, damping=damping)
    _add_mass(body, inertia)


def _add_mass(body: Element, inertia: Inertia) -> None:
    t = inertia.tensor
    full = format_numbers([t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]])
    place, mass = format_numbers(inertia.centre), format_numbers([inertia.mass])
    add_element(body, "inertial", pos=place, mass=mass, fullinertia=full)


def _add_connector(back: Element, equality: Element, model: Biplane, name: str, pair: DiscPair) -> None:
    """The joints between the discs, held with the stiffness of the connector."""
    stiffness = {"x": model.connector.shear, "z": model.connector.shear, "turn": model.connector.twist}
    for joint, inverse_mass in zip(YIELDING_JOINTS, pair.joint_inverse_masses[6:].tolist(), strict=True):
        own = f"{name}_back_{joint}"
        kind = "hinge" if joint == "turn" else "slide"
        add_element(back, "joint", name=own, type=kind, axis=HUB_JOINTS[joint])
        limit = limit_attributes(stiffness[joint], inverse_mass, model.plane.numerics.contact_time)
        holds = {"solref": limit["solreflimit"], "solimp": limit["solimplimit"]}
        add_element(equality, "joint", joint1=own, **holds)
    _add_mass(back, pair.back)


def _add_disc(body: Element, model: Biplane, hub: int, face: Face, parts: FaceParts, has_mesh: bool) -> None:
    name, side, plane = disc_name(hub, face), face_side(face), model.plane
    contact = contact_attributes(plane, float(parts.friction[hub]))
    _site(body, name, side * model.springs_at * _LATERAL)
    foot = {"contype": "0", "conaffinity": "1", "pos": format_numbers(side * model.outside * _LATERAL)}
    hidden = {"group": "3"} if has_mesh else {}
    add_element(body, "geom", name=f"{name}_foot", type="mesh", mesh="hexagon", **foot, **contact, **hidden)
    touching = {"contype": "2", "conaffinity": "2", "pos": format_numbers(side * model.springs_at * _LATERAL)}
    size = format_numbers([plane.contact_radius])
    add_element(body, "geom", name=f"{name}_side", type="sphere", size=size, group="3", **touching, **contact)


def _hinges(
    bodies: Bodies, model: Biplane, name: str, face: Face, hubs: tuple[int, int]
) -> tuple[tuple[str, str], tuple[FloatArray, FloatArray], FloatArray]:
    """Sites of a spring's two hinges, their places in their hubs [m], and the direction from the first to the
    second."""
    a, b = hubs
    offset = model.plane.hubs[b].position - model.plane.hubs[a].position
    along = np.array([offset[0], 0.0, offset[1]]) / np.linalg.norm(offset)
    across = face_side(face) * model.springs_at * _LATERAL
    places = model.plane.socket * along + across, -model.plane.socket * along + across
    ends = (
        _site(bodies[a, face], f"{name}_a", places[0]),
        _site(bodies[b, face], f"{name}_b", places[1]),
    )
    return ends, places, along


def _add_strip(
    tendons: Element, bodies: Bodies, model: Biplane, number: int, face: Face, strip: Strip
) -> None:
    name, time = f"strip_{number:02d}_{face}", model.plane.numerics.contact_time
    ends, places, along = _hinges(bodies, model, name, face, strip.hubs)
    pairs = [model.discs[hub] for hub in strip.hubs]
    inverse_mass = sum(pair.inverse_mass(face, at, along) for pair, at in zip(pairs, places, strict=True))
    add_strip_tendon(tendons, name, ends, strip, inverse_mass, time)
    friction = model.plane.socket_friction / 2
    in_plane = SocketLaw(friction, model.plane.max_rotation or 0.0, strip.bending)
    lateral = SocketLaw(friction, model.lateral_rotation, model.lateral_bending * strip.bending)
    for own, direction in ((0, along), (1, -along)):
        across = np.array([-direction[2], 0.0, direction[0]])
        for law, to, kind in ((in_plane, across, "turn"), (lateral, _LATERAL, "lateral")):
            lever, tip = places[own] + LEVER * strip.length * to, places[own] + strip.length * direction
            pull = (tip - lever) / np.linalg.norm(tip - lever)
            inverse_mass = pairs[own].inverse_mass(face, lever, pull)
            inverse_mass += pairs[1 - own].inverse_mass(face, places[1 - own], pull)
            socket = f"{name}_{'ab'[own]}_{kind}"
            site = _site(bodies[strip.hubs[own], face], f"{socket}_lever", lever)
            tendon = add_element(
                tendons, "spatial", name=socket, group=HIDDEN_GROUP,
                **socket_attributes(law, strip.length, inverse_mass, time),
            )  # fmt: skip
            thread_sites(tendon, site, ends[1 - own])


def _site(body: Element, name: str, place: FloatArray) -> str:
    add_element(body, "site", name=name, pos=format_numbers(place), size="0.001", group=HIDDEN_GROUP)
    return name
