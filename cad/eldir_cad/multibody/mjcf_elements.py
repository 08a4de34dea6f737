"""What both models of a robot in MuJoCo's XML share: ground, options, contacts, limits and sockets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from eldir.built.ground import MIN_SEGMENT
from eldir.core.records import FloatArray
from eldir.terrain import Terrain
from eldir_cad.multibody.hubs import hub_name
from eldir_cad.multibody.model import CoilSpring, Multibody, Strip

LEVER = 50.0
"""Length of the lever of a socket, in lengths of a strip."""
MIN_IMPEDANCE = 0.75
"""Smallest impedance of a limit: a soft limit gets a longer time constant instead."""
HIDDEN_GROUP = "4"
"""Not drawn by MuJoCo's viewer by default."""
HALF_WIDTH = 0.02
"""Of the ground under a robot that stays in its plane [m]."""
_STICTION_ROTATION = math.radians(0.5)  # of a socket before its friction yields
_HUB_DAMPING = 0.1  # damping ratio of a hub that oscillates within that rotation
_REACH = 10.0  # of a terrain before and behind the robot [m]
_NEAR, _MAX_PRISM = 2.0, 0.05  # up to this distance from the robot, pieces of terrain are at most so long [m]
_DEPTH = 0.02  # of a piece under the lowest end of its neighbours [m]


def add_element(parent: Element, tag: str, **attributes: str) -> Element:
    """Add a new element to `parent`."""
    return SubElement(parent, tag, dict(attributes))


def format_numbers(values: FloatArray | Sequence[float]) -> str:
    """Numbers separated by spaces, as in MJCF."""
    return " ".join(f"{float(value):.12g}" for value in values)


def thread_sites(tendon: Element, *sites: str) -> None:
    """Let a tendon run through these sites."""
    for site in sites:
        add_element(tendon, "site", site=site)


def contact_attributes(model: Multibody, friction: float) -> dict[str, str]:
    """Friction and softness of a geom in contact."""
    n = model.numerics
    return {
        "condim": "3",
        "priority": "1",
        "friction": format_numbers([friction]),
        "solref": format_numbers([n.contact_time, 1.0]),
        "solimp": format_numbers([n.impedance, n.impedance, 1e-3, 0.5, 2]),
    }


def limit_attributes(stiffness: float, inverse_mass: float, min_time: float) -> dict[str, str]:
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


@dataclass(frozen=True)
class SocketLaw:
    """How a strip turns in a socket, to either side of its direction in the assembled robot."""

    friction: float
    """Moment at which it begins to turn [N m]."""
    max_rotation: float
    """Angle beyond which it bends [rad]."""
    bending: float
    """E I / l of the strip [N m]."""


def socket_attributes(law: SocketLaw, length: float, inverse_mass: float, min_time: float) -> dict[str, str]:
    """A socket as the tendon from the end of its lever to the hinge at the other end of the strip, `length`
    [m] away. `inverse_mass` [1/kg] along the tendon; `min_time`: as in `limit_attributes`."""
    arm = LEVER / math.hypot(1.0, LEVER) * length

    def tendon_length(turn: float) -> float:
        """By the law of cosines."""
        return length * math.sqrt(1 + LEVER**2 - 2 * LEVER * math.sin(turn))

    limit = max(law.max_rotation, 1e-3)
    stiffness = law.friction / (_STICTION_ROTATION * arm**2)
    friction = (
        {"stiffness": format_numbers([stiffness]), "springyield": format_numbers([_STICTION_ROTATION * arm])}
        if stiffness > 0
        else {}
    )
    return {
        "range": format_numbers([tendon_length(limit), tendon_length(-limit)]),
        "springlength": format_numbers([tendon_length(0.0)]),
        "damping": format_numbers([2 * _HUB_DAMPING * math.sqrt(stiffness / inverse_mass)]),
        **friction,
        **limit_attributes(3 * law.bending / (arm * math.cos(limit)) ** 2, inverse_mass, min_time),
    }


def add_strip_tendon(
    tendons: Element,
    name: str,
    ends: tuple[str, str],
    strip: Strip,
    inverse_mass: float,
    min_time: float,
) -> None:
    """A strip along its length. `inverse_mass` [1/kg] along it; `min_time`: as in `limit_attributes`."""
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
        **limit_attributes(strip.tension, inverse_mass, min_time),
    )
    thread_sites(tendon, *ends)


def add_coil_tendon(
    tendons: Element, actuators: Element, name: str, ends: tuple[str, str], coil: CoilSpring
) -> None:
    """A coil, and the actuator that sets its free length."""
    looks = {"width": "0.0036", "rgba": ".85 .5 .2 1"}
    tendon = add_element(tendons, "spatial", name=name, damping=format_numbers([coil.damping]), **looks)
    thread_sites(tendon, *ends)
    cold = format_numbers([coil.stiffness[0]])
    add_element(actuators, "position", name=name, tendon=name, kp=cold, ctrlrange="0 0.15")


def hinge_distances(model: Multibody) -> FloatArray:
    """Distances between the hinges of each coil in the assembled robot [m], shape (A,)."""
    ends = np.array([[model.hubs[hub].position for hub in coil.hubs] for coil in model.coils])
    offsets = ends.reshape(-1, 2, 2)
    return np.asarray(np.linalg.norm(offsets[:, 0] - offsets[:, 1], axis=1) - 2 * model.socket)


def add_keyframe(root: Element, joints: int, lengths: FloatArray) -> None:
    """The assembled robot with this number of joints: every coil has its present length as free length
    [m], so that it exerts no force."""
    keys = add_element(root, "keyframe")
    pose = {"qpos": format_numbers(np.zeros(joints)), "ctrl": format_numbers(lengths)}
    add_element(keys, "key", name="standing", **pose)


def parts_name(hub: int) -> str:
    """Name of the mesh with the parts of a hub."""
    return f"parts_{hub:02d}"


def add_parts(body: Element, hub: int) -> None:
    """Draw a hub's parts; they touch nothing."""
    looks = {"type": "mesh", "mesh": parts_name(hub), "contype": "0", "conaffinity": "0"}
    add_element(body, "geom", name=f"{hub_name(hub)}_parts", group="1", rgba=".35 .45 .6 1", **looks)


def add_assets(root: Element, model: Multibody) -> Element:
    """The element of meshes, with the hexagon on whose corners a hub stands."""
    assets = add_element(root, "asset")
    if model.corner > 0:
        angles = np.radians(30 + 60 * np.arange(6))
        ring = [(model.corner * math.cos(a), 0.0, model.corner * math.sin(a)) for a in angles]
        apex = model.corner / 2  # makes a solid; each corner touches the table at one point
        points = np.array([*ring, (0, apex, 0), (0, -apex, 0)])
        add_element(assets, "mesh", name="hexagon", vertex=format_numbers(points.ravel()))
    return assets


def add_world(root: Element, assets: Element, model: Multibody, half_width: float) -> Element:
    """The world body with the table, or with a terrain as wide as `half_width` [m] to either side."""
    world = add_element(root, "worldbody")
    table = {"type": "plane", "size": "3 1 0.1", "contype": "1", "conaffinity": "0", "condim": "3"}
    add_element(world, "light", pos="0 -1 2", dir="0 0.4 -1", directional="true")
    looks = {"rgba": ".8 .8 .78 1", "friction": "0.001"}
    if model.terrain is None:
        add_element(world, "geom", name="table", **looks, **table)
    else:
        del table["size"]
        _add_terrain(assets, world, model, model.terrain, half_width, {**table, **looks, "type": "mesh"})
    return world


def _add_terrain(
    assets: Element,
    world: Element,
    model: Multibody,
    terrain: Terrain,
    half_width: float,
    attributes: Mapping[str, str],
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
        points = np.array([(at, side, z) for side in (-half_width, half_width) for at, z in outline])
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


def add_options(root: Element, model: Multibody, side_tilt: float = 0.0) -> None:
    """Compiler, solver, time step, gravity and view. `side_tilt`: the table falls to the back of the robot by
    this angle [rad]."""
    n, g = model.numerics, model.gravity
    level = g * math.cos(model.tilt)
    down = (-g * math.sin(model.tilt), -level * math.sin(side_tilt), level * math.cos(side_tilt))
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
