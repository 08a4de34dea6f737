"""The hubs of a robot as URDF, for viewers of ROS.

URDF is a tree and the lattice has loops. Therefore each hub is a separate branch: it slides along x and z of
the ground and rotates, as in the MJCF. Strips and coils are left out: their positions follow from those of
the hubs. Masses and contacts are missing: a simulator needs the MJCF.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from eldir_cad.multibody.hubs import hub_name
from eldir_cad.multibody.mjcf import add_element

ROOT = "ground"
_TRAVEL_LIMIT = 100.0  # URDF requires a limit; no hub reaches it [m]


def urdf_text(name: str, meshes: Mapping[int, str], middle: float) -> str:
    """The text of a URDF file; `meshes`: address of the STL file of each hub, in metres.

    The hubs' joints move in the plane of the tracking discs, on the front of the robot; `middle`: distance of
    the hubs' middle behind it [m]."""
    root = Element("robot", name=name)
    add_element(root, "link", name=ROOT)
    for hub, file in meshes.items():
        link = hub_name(hub)
        chain = (ROOT, f"{link}_at_x", f"{link}_at_z", link)
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
