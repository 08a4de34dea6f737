"""Strips, sockets and coils as MuJoCo tendons, and the limits that give way with a stiffness.

- A **strip** is a tendon with a soft spring that always pushes with Euler's load, and an upper limit of its
  length. The limit yields with the strip's stiffness in tension. So the strip is stiff up to the load at
  which it buckles, and then pushes with min(K s, PE (1 + s / 2L)), as in the built scene.
- A **socket** is a tendon from the end of a lever across one hub, many strips long, to the hinge in the other
  hub: its length is the place of that hinge across the socket. An elasto-plastic spring on it is the socket's
  friction; a limit at both ends of its range is where the strip bends.
- A **coil** is a tendon with a position actuator: the control is the free length, the gain is the stiffness.
"""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

import numpy as np

from eldir.core.records import FloatArray
from eldir_cad.multibody.elements import add, text_of
from eldir_cad.multibody.hubs import Inertia
from eldir_cad.multibody.model import Coil, Multibody, Strip

LEVER = 50.0
"""Length of a socket's lever in lengths of a strip."""
SMOOTHEST = 0.75
"""Least impedance of a limit: its time constant is longer where it is soft."""
_STICKS = math.radians(0.5)  # rotation of a socket before its friction gives way
_HUB_DAMPING = 0.1  # damping ratio of a hub that swings within that
_HIDDEN = "4"  # group that MuJoCo's viewer does not draw at first


def add_strip(tendons: Element, bodies: list[Element], model: Multibody, number: int, strip: Strip) -> None:
    name, (a, b) = f"strip_{number:02d}", strip.hubs
    along = _along(model, a, b)
    hinge = model.socket * along
    ends = _site(bodies[a], f"{name}_a", hinge), _site(bodies[b], f"{name}_b", -hinge)
    loose = _loose(model.hubs[a].inertia, hinge, along, model) + _loose(
        model.hubs[b].inertia, -hinge, along, model
    )
    length = strip.length - strip.buckling / strip.tension  # the limit gives way by this against the spring
    tendon = add(
        tendons,
        "spatial",
        name=name,
        range=text_of([0.0, length]),
        stiffness=text_of([strip.buckling / (2 * strip.length)]),
        springlength=text_of([3 * strip.length]),
        width="0.0005",
        rgba=".75 .8 .85 1",
        **_limit(strip.tension, loose, model.numerics.contact_time),
    )
    _through(tendon, *ends)
    if model.turn is None:
        return
    for end, hub, other, direction in (("a", a, b, along), ("b", b, a, -along)):
        at = model.socket * direction
        across = np.array([-direction[1], direction[0]])
        lever = _site(bodies[hub], f"{name}_{end}_lever", at + LEVER * strip.length * across, group=_HIDDEN)
        rotation = add(
            tendons,
            "spatial",
            name=f"{name}_{end}_turn",
            group=_HIDDEN,
            **_socket(model, strip, hub, other, at, direction),
        )
        _through(rotation, lever, ends[1 if end == "a" else 0])


def _socket(
    model: Multibody, strip: Strip, hub: int, other: int, at: FloatArray, direction: FloatArray
) -> dict[str, str]:
    """Friction and bending of a strip in the socket `at` of a hub [N m], as forces on its lever."""
    arm = LEVER / math.hypot(1.0, LEVER) * strip.length

    def length(turn: float) -> float:
        """The tendon's, by the law of cosines."""
        return strip.length * math.sqrt(1 + LEVER**2 - 2 * LEVER * math.sin(turn))

    lever = at + LEVER * strip.length * np.array([-direction[1], direction[0]])
    tip = at + strip.length * direction
    pulls = (tip - lever) / np.linalg.norm(tip - lever)
    hinge = -model.socket * direction
    loose = _loose(model.hubs[hub].inertia, lever, pulls, model) + _loose(
        model.hubs[other].inertia, hinge, pulls, model
    )
    most = max(model.turn or 0.0, 1e-3)
    sticks = model.socket_friction / (_STICKS * arm**2)
    yields = {"stiffness": text_of([sticks]), "springyield": text_of([_STICKS * arm])} if sticks > 0 else {}
    return {
        "range": text_of([length(most), length(-most)]),
        "springlength": text_of([length(0.0)]),
        "damping": text_of([2 * _HUB_DAMPING * math.sqrt(sticks / loose)]),
        **yields,
        **_limit(3 * strip.bending / (arm * math.cos(most)) ** 2, loose, model.numerics.contact_time),
    }


def add_coil(
    tendons: Element, actuators: Element, bodies: list[Element], model: Multibody, number: int, coil: Coil
) -> None:
    name, (a, b) = f"coil_{number}", coil.hubs
    hinge = model.socket * _along(model, a, b)
    ends = _site(bodies[a], f"{name}_a", hinge), _site(bodies[b], f"{name}_b", -hinge)
    looks = {"width": "0.0036", "rgba": ".85 .5 .2 1"}
    _through(add(tendons, "spatial", name=name, damping=text_of([coil.damping]), **looks), *ends)
    cold = text_of([coil.stiffness[0]])
    add(actuators, "position", name=name, tendon=name, kp=cold, ctrlrange="0 0.15")


def _along(model: Multibody, a: int, b: int) -> FloatArray:
    """Unit vector from hub a to hub b, as assembled."""
    way = model.hubs[b].place - model.hubs[a].place
    return np.asarray(way / np.linalg.norm(way))


def _loose(inertia: Inertia, at: FloatArray, direction: FloatArray, model: Multibody) -> float:
    """Acceleration along a unit vector by a unit force along it, at a place in a hub [1/kg]."""
    if model.turn is None:
        return 1 / inertia.mass
    arm = at - inertia.centre[[0, 2]]
    return 1 / inertia.mass + (arm[0] * direction[1] - arm[1] * direction[0]) ** 2 / inertia.tensor[1, 1]


def _limit(stiffness: float, loose: float, least: float) -> dict[str, str]:
    """A limit that gives way with `stiffness` [N/m], critically damped, in no less than `least` [s].

    A limit at rest yields by f (1 - d) T^2 w with the impedance d, the time constant T and the inverse mass w
    (MuJoCo, "Solver parameters").
    """
    time = max(least, 1 / math.sqrt((1 - SMOOTHEST) * stiffness * loose))
    impedance = 1 - 1 / (stiffness * loose * time**2)
    return {
        "solreflimit": text_of([time, 1.0]),
        "solimplimit": text_of([impedance, impedance, 1e-3, 0.5, 2]),
    }


def _site(body: Element, name: str, place: FloatArray, group: str = _HIDDEN) -> str:
    add(body, "site", name=name, pos=text_of([place[0], 0.0, place[1]]), size="0.001", group=group)
    return name


def _through(tendon: Element, *sites: str) -> None:
    for site in sites:
        add(tendon, "site", site=site)
