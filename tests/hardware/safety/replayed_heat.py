"""Replays contact edges that an emulated board recorded, through the independent thermal model."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.player import Player
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.safety.independent_heat import STEP, Wire, still_air, temperatures
from tests.hardware.virtual.piston_and_observer import Piston

Pulses = list[tuple[float, float]]


class Corner(NamedTuple):
    """Where the bench is within the tolerances; parts of the nominal values."""

    ambient: float
    current: float
    resistance: float
    convection_tolerance: float


HOTTEST = Corner(30.0, 1.05, 1.05, 0.9)
NOMINAL = Corner(22.0, 1.0, 1.0, 1.0)
CORNERS = [Corner(*c) for c in product((18.0, 30.0), (0.95, 1.05), (0.95, 1.05), (0.9, 1.1))]


def recorded_pulses(schedule: ActuationSchedule, rig: Rig) -> dict[int, Pulses]:
    """Play a schedule with the real driver on the emulated board; the pulses of its contacts, by channel."""
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        Player(bank, schedule, rig, virtual.clock).play()
        edges = list(virtual.emulator.contact_events)
    found: dict[int, Pulses] = {}
    for channel in sorted({e.channel for e in edges}):
        own = [e for e in edges if e.channel == channel]
        assert [e.closed for e in own] == [True, False] * (len(own) // 2)
        found[channel] = [(a.t, b.t) for a, b in zip(own[::2], own[1::2], strict=True)]
    return found


def wire(rig: Rig, corner: Corner, *, fan: bool = True) -> Wire:
    """The spring of a rig file in a corner of its tolerances."""
    s = rig.springs
    blown = (s.convection_fan or 150.0) * corner.convection_tolerance
    still = still_air(1e-3 * s.wire_diameter_mm, corner.ambient)
    return Wire(
        current=rig.supply.current_limit_a * corner.current,
        resistance=s.resistance_ohm * corner.resistance,
        ambient=corner.ambient,
        coefficient=(lambda surface: blown) if fan else still,
        diameter=1e-3 * s.wire_diameter_mm,
        length=math.pi * 1e-3 * s.coil_diameter_mm * s.turns,
        heat_capacity=s.heat_capacity,
        latent_heat=s.latent_heat,
    )


def distinct(pulses: dict[int, Pulses]) -> Iterator[Pulses]:
    """The pulses of each channel, once for channels that switch alike to 10 ms."""
    seen = set()
    for own in pulses.values():
        key = tuple(round(t, 2) for t, _ in own)
        if key not in seen:
            seen.add(key)
            yield own


def peak(pulses: dict[int, Pulses], spring: Wire) -> float:
    """Highest temperature of a spring on any channel [C]."""
    return max(max(temperatures(spring, own, own[-1][1] + 1.0)) for own in distinct(pulses))


def welded(pulses: dict[int, Pulses], rig: Rig) -> dict[int, Pulses]:
    """The same, but the contact of the last pulse welds, and only the timer relay opens its circuit."""
    assert rig.cutoff_s is not None
    return {c: [*own[:-1], (own[-1][0], own[-1][0] + rig.cutoff_s)] for c, own in pulses.items()}


def stopped_fan(pulses: Pulses, rig: Rig, corner: Corner, at: float) -> float:
    """Peak if the fan stops at an instant and its interlock cuts the supply [C]: the rest in still air."""
    before = [(a, min(b, at)) for a, b in pulses if a < at]
    spring = wire(rig, corner)
    blown = spring.coefficient
    calm = wire(rig, corner, fan=False).coefficient
    spring_until = temperatures(spring, before, at)
    # The coefficient changes in mid-run: the model calls it four times a step.
    calls = round(at / STEP) * 4
    count = iter(range(1 << 60))
    changing = spring.__class__(
        **{**vars(spring), "coefficient": lambda t: blown(t) if next(count) < calls else calm(t)}
    )
    return max(*temperatures(changing, before, at + 20.0), *spring_until)
