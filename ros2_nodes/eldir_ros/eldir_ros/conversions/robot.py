# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The robot for viewers: its description (URDF), joints and frames of its hubs, and its springs as lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir_cad.multibody.hubs import hub_name
from eldir_cad.multibody.mjcf_elements import add_element
from eldir_ros.conversions import NewMessage, header_of
from eldir_ros.conversions.frames import transform_of

_LINE_LIST, _ADD = 5, 0  # of visualization_msgs/Marker
_STRIP = 0.002  # width of a line [m]
_COLOURS = {True: (0.85, 0.3, 0.2), False: (0.65, 0.65, 0.65)}
_ROOT = "ground"
_TRAVEL_LIMIT = 100.0  # URDF requires a limit; no hub reaches it [m]


def urdf_text(name: str, meshes: Mapping[int, str], middle: float) -> str:
    """The text of a URDF file; `meshes`: address of the STL file of each hub, in metres.

    URDF is a tree and the lattice has loops. Therefore each hub is a separate branch: it slides along x and z
    of the ground and rotates, as in the MJCF. Strips and coils are left out: their positions follow from
    those of the hubs. Masses and contacts are missing: a simulator needs the MJCF.
    The hubs' joints move in the plane of the tracking discs, on the front of the robot; `middle`: distance of
    the hubs' middle behind it [m]."""
    root = Element("robot", name=name)
    add_element(root, "link", name=_ROOT)
    for hub, file in meshes.items():
        link = hub_name(hub)
        chain = (_ROOT, f"{link}_at_x", f"{link}_at_z", link)
        joints = (("x", "prismatic", "1 0 0"), ("z", "prismatic", "0 0 1"), ("turn", "continuous", "0 -1 0"))
        for parent, child, (axis, kind, direction) in zip(chain, chain[1:], joints, strict=False):
            joint = add_element(root, "joint", name=f"{link}_{axis}", type=kind)
            add_element(joint, "parent", link=parent)
            add_element(joint, "child", link=child)
            add_element(joint, "axis", xyz=direction)
            if kind == "prismatic":
                add_element(
                    joint,
                    "limit",
                    lower=f"{-_TRAVEL_LIMIT:g}",
                    upper=f"{_TRAVEL_LIMIT:g}",
                    effort="0",
                    velocity="0",
                )
            element = add_element(root, "link", name=child)
            if child == link:
                visual = add_element(element, "visual")
                add_element(visual, "origin", xyz=f"0 {middle:g} 0")
                add_element(add_element(visual, "geometry"), "mesh", filename=file)
                add_element(add_element(visual, "material", name="printed"), "color", rgba="0.35 0.45 0.6 1")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def joints_of(new_message: NewMessage, stamp: int, positions: FloatArray, angles: FloatArray) -> Any:
    """sensor_msgs/JointState of hubs at (M, 2) [m], turned by `angles` (M,) [rad]."""
    names = [f"{hub_name(hub)}_{axis}" for hub in range(len(positions)) for axis in ("x", "z", "turn")]
    values = np.column_stack([positions, angles]).ravel().tolist()
    header = header_of(new_message, stamp)
    return new_message("sensor_msgs/msg/JointState", header=header, name=names, position=values)


def frames_of(
    new_message: NewMessage, stamp: int, positions: FloatArray, angles: FloatArray, ground: str
) -> Any:
    """tf2_msgs/TFMessage of every link of the hubs; `ground` is the name of the root's frame, whose prefix
    all have."""
    prefix = ground[: ground.rfind("/") + 1]
    still, transforms = np.eye(3), []
    for hub, ((x, z), angle) in enumerate(zip(positions.tolist(), angles.tolist(), strict=True)):
        link = prefix + hub_name(hub)
        at_x, at_z = f"{link}_at_x", f"{link}_at_z"
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])  # about -y: from x to z
        transforms += [
            transform_of(new_message, stamp, ground, at_x, np.array([x, 0.0, 0.0]), still),
            transform_of(new_message, stamp, at_x, at_z, np.array([0.0, 0.0, z]), still),
            transform_of(new_message, stamp, at_z, link, np.zeros(3), turn),
        ]
    return new_message("tf2_msgs/msg/TFMessage", transforms=transforms)


def springs_of(
    new_message: NewMessage,
    stamp: int,
    positions: FloatArray,
    springs: IntArray,
    active: BoolArray,
    planes: tuple[float, ...],
    frame: str,
) -> Any:
    """visualization_msgs/MarkerArray of the springs (S, 2): coils in one colour, strips in another.

    `planes`: those of the faces' springs, behind the plane of motion [m]."""
    markers = []
    for number, is_coil in enumerate((False, True)):
        ends = positions[springs[active == is_coil].ravel()].tolist()
        red, green, blue = _COLOURS[is_coil]
        markers.append(
            new_message(
                "visualization_msgs/msg/Marker",
                header=header_of(new_message, stamp, frame),
                ns="coils" if is_coil else "strips",
                id=number,
                type=_LINE_LIST,
                action=_ADD,
                pose=new_message(
                    "geometry_msgs/msg/Pose",
                    position=new_message("geometry_msgs/msg/Point"),
                    orientation=new_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
                ),
                scale=new_message("geometry_msgs/msg/Vector3", x=_STRIP, y=0.0, z=0.0),
                color=new_message("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
                points=[
                    new_message("geometry_msgs/msg/Point", x=x, y=y, z=z) for y in planes for x, z in ends
                ],
            )
        )
    return new_message("visualization_msgs/msg/MarkerArray", markers=markers)
