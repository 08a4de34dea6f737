"""Small models with closed forms, and a walker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eldir.built.gait import FreeLengths
from eldir.core.records import FloatArray
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.hubs import Inertia
from eldir_cad.multibody.model import CoilSpring, Hub, Multibody, Strip, build_multibody, with_pins
from eldir_hardware.virtual.mujoco_body import MujocoMotion

FREE = (0.035, 0.075)
"""Cold and hot free length of the nominal spring [m]."""
LENGTH, TENSION, BUCKLING, BENDING = 0.0496, 322e3, 7.02, 0.0353


def hub(x: float, y: float = 0.0, mass: float = 5e-3, inertia: float = 1e-7, friction: float = 0.5) -> Hub:
    return Hub(np.array([x, y]), Inertia(mass, np.zeros(3), inertia * np.eye(3)), friction)


def small(
    hubs: Sequence[Hub], strips: Sequence[Strip] = (), coils: Sequence[CoilSpring] = (), **changes: object
) -> Multibody:
    """Hubs that are points, without gravity and drag, unless changed."""
    plain = Multibody(
        hubs, strips, coils, socket=0.0, corner=0.0, contact_radius=6e-3, max_rotation=None,
        socket_friction=0.0, parameters=BuiltParameters(drag=0.0), gravity=0.0,
    )  # fmt: skip
    return changed(plain, changes)


def changed(model: Multibody, changes: dict[str, object]) -> Multibody:
    """The model with other values of itself, or of its robot's parameters."""
    own = {name: value for name, value in changes.items() if not hasattr(model, name)}
    parameters = replace(model.parameters, **own)
    return replace(model, parameters=parameters, **{n: v for n, v in changes.items() if n not in own})


def strip(length: float = LENGTH) -> Strip:
    return Strip((0, 1), length, TENSION, BUCKLING, BENDING)


def robot(body: Morphology, **changes: object) -> Multibody:
    """The nominal robot of a body."""
    return changed(build_multibody(body, load_specification(), load_printer("xip")), changes)


def pinned(body: Morphology, **changes: object) -> Multibody:
    """The same as points: the masses and lengths of the built scene, pins at the centres, hubs that do not
    turn."""
    from eldir.built.robot import build

    there, model = build(body), with_pins(robot(body))
    hubs = [
        hub(float(x), float(y), mass=float(2 * m), friction=one.friction)
        for (x, y), m, one in zip(there.positions, there.masses, model.hubs, strict=True)
    ]
    return changed(replace(model, hubs=hubs), changes)


def walk(model: Multibody, table: FreeLengths, cycles: int) -> tuple[float, FloatArray]:
    """Body lengths per five cycles, and positions every second of the cycles that count, shape (T, M, 2)."""
    motion, every = MujocoMotion(model, FREE), 20
    begun, found = motion.positions, []
    for row in range(0, len(table.lengths) - 1, every):
        motion.follow(table.lengths[row : row + every + 1], table.interval)
        found.append(motion.positions)
    counted = np.array(found[table.first_cycle // every - 1 :])
    forward = counted[-1, :, 0].mean() - counted[0, :, 0].mean()
    return float(forward / np.ptp(begun[:, 0]) * 5 / cycles), counted
