# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The robot for viewers: its description (URDF), joints and frames of its hubs, and its springs as lines."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir_cad.multibody.hubs import hub_name
from eldir_cad.multibody.mjcf_elements import add_element
from eldir_ros.conversions import header_of
from eldir_ros.conversions.frames import transform_of

_STRIP = 0.002  # width of a line [m]
_COLOURS = {True: (0.85, 0.3, 0.2), False: (0.65, 0.65, 0.65)}
_PREDICTED_COLOUR = (0.2, 0.5, 0.9)
PREDICTED = "predicted"
"""Prefix of the predicted robot's frames, and of its markers' namespaces."""
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


def joints_of(stamp: int, positions: FloatArray, angles: FloatArray) -> JointState:
    """Joints of hubs at (M, 2) [m], turned by `angles` (M,) [rad]."""
    names = [f"{hub_name(hub)}_{axis}" for hub in range(len(positions)) for axis in ("x", "z", "turn")]
    values = np.column_stack([positions, angles]).ravel().tolist()
    header = header_of(stamp)
    return JointState(header=header, name=names, position=values)


def frames_of(
    stamp: int, positions: FloatArray, angles: FloatArray, ground: str, is_predicted: bool = False
) -> TFMessage:
    """Frames of every link of the hubs; `ground` is the name of the root's frame, whose prefix all have.
    Those of the predicted robot have `PREDICTED` after it."""
    prefix = ground[: ground.rfind("/") + 1] + (f"{PREDICTED}/" if is_predicted else "")
    still, transforms = np.eye(3), []
    for hub, ((x, z), angle) in enumerate(zip(positions.tolist(), angles.tolist(), strict=True)):
        link = prefix + hub_name(hub)
        at_x, at_z = f"{link}_at_x", f"{link}_at_z"
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])  # about -y: from x to z
        transforms += [
            transform_of(stamp, ground, at_x, np.array([x, 0.0, 0.0]), still),
            transform_of(stamp, at_x, at_z, np.array([0.0, 0.0, z]), still),
            transform_of(stamp, at_z, link, np.zeros(3), turn),
        ]
    return TFMessage(transforms=transforms)


def springs_of(
    stamp: int,
    positions: FloatArray,
    springs: IntArray,
    active: BoolArray,
    planes: tuple[float, ...],
    frame: str,
    is_predicted: bool = False,
) -> MarkerArray:
    """The springs (S, 2) as lines: coils in one colour, strips in another, the predicted robot's in a third.

    `planes`: those of the faces' springs, behind the plane of motion [m]."""
    markers = []
    for number, is_coil in enumerate((False, True)):
        ends = positions[springs[active == is_coil].ravel()].tolist()
        red, green, blue = _PREDICTED_COLOUR if is_predicted else _COLOURS[is_coil]
        part = "coils" if is_coil else "strips"
        markers.append(
            Marker(
                header=header_of(stamp, frame),
                ns=f"{PREDICTED} {part}" if is_predicted else part,
                id=number,
                type=Marker.LINE_LIST,
                action=Marker.ADD,
                pose=Pose(
                    position=Point(),
                    orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
                ),
                scale=Vector3(x=_STRIP, y=0.0, z=0.0),
                color=ColorRGBA(r=red, g=green, b=blue, a=1.0),
                points=[Point(x=x, y=y, z=z) for y in planes for x, z in ends],
            )
        )
    return MarkerArray(markers=markers)
