"""The hubs of a robot as URDF, for viewers of ROS.

URDF is a tree and the lattice has loops. Each hub is therefore a branch of its own: it slides along x and z
of the ground and turns, as in the MJCF. Strips and coils are left out: what is between two hubs follows from
where the hubs are. There is nothing about mass or contact: a simulator needs the MJCF.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from eldir_cad.multibody.elements import add

ROOT = "ground"
_FAR = 100.0  # a hub is nowhere near this limit [m]


def hub_name(hub: int) -> str:
    """Name of a hub's link; its joints are this name with _x, _z and _turn."""
    return f"hub_{hub:02d}"


def urdf(name: str, meshes: Mapping[int, str], middle: float) -> str:
    """The text of a URDF file; `meshes`: address of the STL file of each hub [m].

    The hubs' joints move in the plane of the tracking discs, on the front of the robot; `middle`: distance of
    the hubs' middle behind it [m]."""
    root = Element("robot", name=name)
    add(root, "link", name=ROOT)
    for hub, file in meshes.items():
        link = hub_name(hub)
        chain = (ROOT, f"{link}_at_x", f"{link}_at_z", link)
        joints = (("x", "prismatic", "1 0 0"), ("z", "prismatic", "0 0 1"), ("turn", "continuous", "0 -1 0"))
        for parent, child, (axis, kind, direction) in zip(chain, chain[1:], joints, strict=False):
            joint = add(root, "joint", name=f"{link}_{axis}", type=kind)
            add(joint, "parent", link=parent)
            add(joint, "child", link=child)
            add(joint, "axis", xyz=direction)
            if kind == "prismatic":
                add(joint, "limit", lower=f"{-_FAR:g}", upper=f"{_FAR:g}", effort="0", velocity="0")
            element = add(root, "link", name=child)
            if child == link:
                visual = add(element, "visual")
                add(visual, "origin", xyz=f"0 {middle:g} 0")
                add(add(visual, "geometry"), "mesh", filename=file)
                add(add(visual, "material", name="printed"), "color", rgba="0.35 0.45 0.6 1")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
