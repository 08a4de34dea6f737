"""The multibody model as MJCF, MuJoCo's XML: hubs are bodies, strips and coils are tendons.

- A **hub** slides in x and z and rotates about y. Its own drag slows each of these motions.
- A **strip** is a tendon with a soft spring that always pushes with Euler's load, and an upper limit of its
  length. The limit yields with the strip's stiffness in tension. So the strip is stiff up to the load at
  which it buckles, and then pushes with min(K s, PE (1 + s / 2L)), as in the built scene.
- A **socket** is a tendon from the end of a lever across one hub, many strips long, to the hinge in the other
  hub: its length is the position of that hinge across the socket. An elasto-plastic spring on it is the
  friction of the socket; a limit at both ends of its range is where the strip bends.
- A **coil** is a tendon with a position actuator: the control is the free length, the gain is the stiffness.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from eldir.built.ground import MIN_SEGMENT
from eldir.core.records import FloatArray
from eldir.terrain import Terrain
from eldir_cad.multibody.hubs import Inertia, hub_name
from eldir_cad.multibody.model import CoilSpring, Hub, Multibody, Strip

LEVER = 50.0
"""Length of the lever of a socket, in lengths of a strip."""
MIN_IMPEDANCE = 0.75
"""Smallest impedance of a limit: a soft limit gets a longer time constant instead."""
_STICTION_ROTATION = math.radians(0.5)  # of a socket before its friction yields
_HUB_DAMPING = 0.1  # damping ratio of a hub that oscillates within that rotation
_HIDDEN_GROUP = "4"  # not drawn by MuJoCo's viewer by default
_POINT_RADIUS = 1e-4  # radius of a hub that is a point [m]
_REACH = 10.0  # of a terrain before and behind the robot [m]
_NEAR, _MAX_PRISM = 2.0, 0.05  # up to this distance from the robot, pieces of terrain are at most so long [m]
_DEPTH = 0.02  # of a piece under the lowest end of its neighbours [m]
_HALF_WIDTH = 0.02  # of a piece [m]


def _add_strip(tendons: Element, bodies: list[Element], model: Multibody, number: int, strip: Strip) -> None:
    name, (a, b) = f"strip_{number:02d}", strip.hubs
    along = _direction(model, a, b)
    hinge = model.socket * along
    ends = _site(bodies[a], f"{name}_a", hinge), _site(bodies[b], f"{name}_b", -hinge)
    inverse_mass = _inverse_mass(model.hubs[a].inertia, hinge, along, model) + _inverse_mass(
        model.hubs[b].inertia, -hinge, along, model
    )
    length = strip.length - strip.buckling / strip.tension  # the limit yields by this against the spring
    tendon = add_element(
        tendons,
        "spatial",
        name=name,
        range=format_numbers([0.0, length]),
        stiffness=format_numbers([strip.buckling / (2 * strip.length)]),
        springlength=format_numbers([3 * strip.length]),
        width="0.0005",
        rgba=".75 .8 .85 1",
        **_limit(strip.tension, inverse_mass, model.numerics.contact_time),
    )
    _through(tendon, *ends)
    if model.max_rotation is None:
        return
    for end, hub, other, direction in (("a", a, b, along), ("b", b, a, -along)):
        at = model.socket * direction
        across = np.array([-direction[1], direction[0]])
        lever = _site(
            bodies[hub], f"{name}_{end}_lever", at + LEVER * strip.length * across, group=_HIDDEN_GROUP
        )
        rotation = add_element(
            tendons,
            "spatial",
            name=f"{name}_{end}_turn",
            group=_HIDDEN_GROUP,
            **_socket(model, strip, hub, other, at, direction),
        )
        _through(rotation, lever, ends[1 if end == "a" else 0])


def _socket(
    model: Multibody, strip: Strip, hub: int, other: int, at: FloatArray, direction: FloatArray
) -> dict[str, str]:
    """Friction and bending of a strip in the socket `at` of a hub [N m], as forces on its lever."""
    arm = LEVER / math.hypot(1.0, LEVER) * strip.length

    def length(turn: float) -> float:
        """Length of the tendon, by the law of cosines."""
        return strip.length * math.sqrt(1 + LEVER**2 - 2 * LEVER * math.sin(turn))

    lever = at + LEVER * strip.length * np.array([-direction[1], direction[0]])
    tip = at + strip.length * direction
    pull = (tip - lever) / np.linalg.norm(tip - lever)
    hinge = -model.socket * direction
    inverse_mass = _inverse_mass(model.hubs[hub].inertia, lever, pull, model) + _inverse_mass(
        model.hubs[other].inertia, hinge, pull, model
    )
    limit = max(model.max_rotation or 0.0, 1e-3)
    stiffness = model.socket_friction / (_STICTION_ROTATION * arm**2)
    friction = (
        {"stiffness": format_numbers([stiffness]), "springyield": format_numbers([_STICTION_ROTATION * arm])}
        if stiffness > 0
        else {}
    )
    return {
        "range": format_numbers([length(limit), length(-limit)]),
        "springlength": format_numbers([length(0.0)]),
        "damping": format_numbers([2 * _HUB_DAMPING * math.sqrt(stiffness / inverse_mass)]),
        **friction,
        **_limit(3 * strip.bending / (arm * math.cos(limit)) ** 2, inverse_mass, model.numerics.contact_time),
    }


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
    looks = {"width": "0.0036", "rgba": ".85 .5 .2 1"}
    _through(
        add_element(tendons, "spatial", name=name, damping=format_numbers([coil.damping]), **looks), *ends
    )
    cold = format_numbers([coil.stiffness[0]])
    add_element(actuators, "position", name=name, tendon=name, kp=cold, ctrlrange="0 0.15")


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


def _limit(stiffness: float, inverse_mass: float, min_time: float) -> dict[str, str]:
    """A limit that yields with `stiffness` [N/m], critically damped, with a time constant of at least
    `min_time` [s].

    A limit at rest yields by f (1 - d) T^2 w with the impedance d, the time constant T and the inverse mass w
    (MuJoCo, "Solver parameters").
    """
    time = max(min_time, 1 / math.sqrt((1 - MIN_IMPEDANCE) * stiffness * inverse_mass))
    impedance = 1 - 1 / (stiffness * inverse_mass * time**2)
    return {
        "solreflimit": format_numbers([time, 1.0]),
        "solimplimit": format_numbers([impedance, impedance, 1e-3, 0.5, 2]),
    }


def _site(body: Element, name: str, place: FloatArray, group: str = _HIDDEN_GROUP) -> str:
    add_element(
        body, "site", name=name, pos=format_numbers([place[0], 0.0, place[1]]), size="0.001", group=group
    )
    return name


def _through(tendon: Element, *sites: str) -> None:
    for site in sites:
        add_element(tendon, "site", site=site)


def add_element(parent: Element, tag: str, **attributes: str) -> Element:
    """Add a new element to `parent`."""
    return SubElement(parent, tag, dict(attributes))


def format_numbers(values: FloatArray | Sequence[float]) -> str:
    """Numbers separated by spaces, as in MJCF."""
    return " ".join(f"{float(value):.12g}" for value in values)


def mjcf_text(model: Multibody, name: str = "robot", meshes: Mapping[int, str] | None = None) -> str:
    """The model as the text of an MJCF file; the same model gives the same text.

    `meshes`: files with the shape of each hub, relative to the MJCF file; they are drawn and touch nothing.
    """
    root = Element("mujoco", model=name)
    _add_options(root, model)
    assets = add_element(root, "asset")
    if model.corner > 0:
        angles = np.radians(30 + 60 * np.arange(6))
        ring = [(model.corner * math.cos(a), 0.0, model.corner * math.sin(a)) for a in angles]
        apex = model.corner / 2  # makes a solid; each corner touches the table at one point
        points = np.array([*ring, (0, apex, 0), (0, -apex, 0)])
        add_element(assets, "mesh", name="hexagon", vertex=format_numbers(points.ravel()))
    for hub, file in (meshes or {}).items():
        add_element(assets, "mesh", name=f"parts_{hub:02d}", file=file)
    world = add_element(root, "worldbody")
    table = {"type": "plane", "size": "3 1 0.1", "contype": "1", "conaffinity": "0", "condim": "3"}
    add_element(world, "light", pos="0 -1 2", dir="0 0.4 -1", directional="true")
    looks = {"rgba": ".8 .8 .78 1", "friction": "0.001"}
    if model.terrain is None:
        add_element(world, "geom", name="table", **looks, **table)
    else:
        del table["size"]
        _add_terrain(assets, world, model, model.terrain, {**table, **looks, "type": "mesh"})
    bodies = [_add_hub(world, model, i, hub, i in (meshes or {})) for i, hub in enumerate(model.hubs)]
    tendons = add_element(root, "tendon")
    actuators = add_element(root, "actuator")
    for number, strip in enumerate(model.strips):
        _add_strip(tendons, bodies, model, number, strip)
    for number, coil in enumerate(model.coils):
        _add_coil(tendons, actuators, bodies, model, number, coil)
    _add_keyframe(root, model)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_terrain(
    assets: Element, world: Element, model: Multibody, terrain: Terrain, attributes: Mapping[str, str]
) -> None:
    """Prisms under the terrain, down to below their neighbours. Near the robot they are short, because MuJoCo
    finds contacts of a small part with a large one less exactly."""
    edges = _prism_edges(terrain, np.array([hub.position[0] for hub in model.hubs]))
    heights = terrain.height(edges)
    for number, pair in enumerate(pairwise(edges)):
        name = f"ground_{number:03d}"
        bottom = heights[max(number - 1, 0) : number + 3].min() - _DEPTH
        top = heights[number : number + 2]
        outline = [*zip(pair, top, strict=True), *((at, bottom) for at in pair[::-1])]
        points = np.array([(at, side, z) for side in (-_HALF_WIDTH, _HALF_WIDTH) for at, z in outline])
        add_element(assets, "mesh", name=name, vertex=format_numbers(points.ravel()))
        add_element(world, "geom", name=name, mesh=name, **attributes)


def _prism_edges(terrain: Terrain, robot: FloatArray) -> FloatArray:
    """Where prisms begin and end [m], wherever the terrain's own segments lie: its first and its last one
    have no end. `robot`: positions of the hubs along the ground."""
    first, last = robot.min() - _REACH, robot.max() + _REACH
    corners = terrain.x0[1:]
    ends = np.concatenate([[first], corners[(corners > first) & (corners < last)], [last]])
    found = [ends[:1]]
    for start, end in pairwise(ends):
        near = max(start, robot.min() - _NEAR), min(end, robot.max() + _NEAR)
        if near[0] < near[1]:
            inside = np.linspace(*near, math.ceil((near[1] - near[0]) / _MAX_PRISM) + 1)
            found.append(inside[(inside > start + MIN_SEGMENT) & (inside < end - MIN_SEGMENT)])
        found.append(np.array([end]))
    return np.concatenate(found)


def _add_options(root: Element, model: Multibody) -> None:
    n, g = model.numerics, model.gravity
    down = (-g * math.sin(model.tilt), 0.0, g * math.cos(model.tilt))
    add_element(
        root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true", balanceinertia="false"
    )
    option = {
        "timestep": format_numbers([n.step]),
        "gravity": format_numbers(down),
        "impratio": format_numbers([n.impratio]),
    }
    solver = {"cone": "elliptic", "integrator": "Euler", "solver": "Newton", "tolerance": "1e-10"}
    flags = add_element(root, "option", **option, **solver)
    add_element(flags, "flag", autoreset="disable", island="disable")  # one robot is one island
    positions = np.array([hub.position for hub in model.hubs])
    middle, extent = (
        (positions.min(axis=0) + positions.max(axis=0)) / 2,
        float(np.ptp(positions, axis=0).max()),
    )
    centre = format_numbers([middle[0], 0.0, middle[1]])
    add_element(
        root,
        "statistic",
        center=centre,
        extent=format_numbers([extent + 0.05]),
        meansize=format_numbers([0.01]),
    )


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
    n = model.numerics
    contact = {
        "condim": "3",
        "priority": "1",
        "friction": format_numbers([hub.friction]),
        "solref": format_numbers([n.contact_time, 1.0]),
        "solimp": format_numbers([n.impedance, n.impedance, 1e-3, 0.5, 2]),
    }
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
        looks = {"type": "mesh", "mesh": f"parts_{number:02d}", "contype": "0", "conaffinity": "0"}
        add_element(body, "geom", name=f"{name}_parts", group="1", rgba=".35 .45 .6 1", **looks)
    return body


def _add_keyframe(root: Element, model: Multibody) -> None:
    """The assembled robot: every coil has its present length as free length, so that it exerts no force."""
    joints = 2 if model.max_rotation is None else 3
    lengths = [
        float(np.linalg.norm(model.hubs[a].position - model.hubs[b].position)) - 2 * model.socket
        for a, b in (coil.hubs for coil in model.coils)
    ]
    keys = add_element(root, "keyframe")
    zero = format_numbers(np.zeros(joints * len(model.hubs)))
    add_element(keys, "key", name="standing", qpos=zero, ctrl=format_numbers(lengths))


def _inertia_about_centre(inertia: Inertia) -> float:
    return float(inertia.tensor[1, 1] + inertia.mass * (inertia.centre[[0, 2]] ** 2).sum())
