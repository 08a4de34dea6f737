"""The multibody model with one of its laws taken away, to find which of them a walk depends on.

Each function returns another model of the same robot; the rest of it stays as it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from eldir_cad.multibody.hubs import Inertia
from eldir_cad.multibody.model import Multibody

_FREE = math.radians(80)  # no strip turns so far: hubs touch each other before
_NO_RADIUS = 1e-6  # of hubs that do not touch each other [m]


def with_pins(model: Multibody) -> Multibody:
    """Hubs are points that do not turn, and strips are pinned to their centres, as in the built scene."""
    hubs = [replace(hub, inertia=Inertia(hub.inertia.mass, np.zeros(3), np.eye(3))) for hub in model.hubs]
    strips = [replace(strip, length=strip.length + 2 * model.socket) for strip in model.strips]
    return replace(
        model, hubs=hubs, strips=strips, socket=0.0, corner=0.0, turn=None, socket_friction=0.0
    )  # fmt: skip


def without_socket_friction(model: Multibody) -> Multibody:
    """Strips turn in their sockets without friction."""
    return replace(model, socket_friction=0.0)


def without_socket_range(model: Multibody) -> Multibody:
    """Strips turn in their sockets without end. Hubs then turn between strips that push past their centres,
    and some robots fall."""
    return replace(model, turn=None if model.turn is None else _FREE)


def with_equal_feet(model: Multibody) -> Multibody:
    """All hubs have the mean friction of the robot's."""
    mean = float(np.mean([hub.friction for hub in model.hubs]))
    return replace(model, hubs=[replace(hub, friction=mean) for hub in model.hubs])


def without_hub_contact(model: Multibody) -> Multibody:
    """Hubs do not touch each other."""
    return replace(model, touching=_NO_RADIUS)


def on_level_table(model: Multibody) -> Multibody:
    """The table does not slope."""
    return replace(model, tilt=0.0)


SIMPLER: dict[str, Callable[[Multibody], Multibody]] = {
    "hubs and sockets": with_pins,
    "socket friction": without_socket_friction,
    "socket range": without_socket_range,
    "feet that differ": with_equal_feet,
    "contact between hubs": without_hub_contact,
    "slope of the table": on_level_table,
}
"""What can be taken away, and how."""
