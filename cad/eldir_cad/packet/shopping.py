"""What a robot and its bench need besides the print, with numbers, ratings and the rule behind each."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eldir.parameters.bench import CONTACT_RATING_A, MAX_ON_S, MAX_TOTAL_CURRENT_A, TIMER_S
from eldir.parameters.wiring import Wiring
from eldir_cad.checks.strip_law import spring_parameters
from eldir_cad.kit.prices import ItemName
from eldir_cad.packet._circuit import (
    STRAND_RESISTIVITY,
    Circuit,
    air_speed,
    awg,
)
from eldir_cad.packet.manifest import Content

TO_TERMINALS = 0.5
"""Length of a lead from the top of the robot to the terminals above it [m]; the rest is in wiring.csv."""
ON_BENCH = 1.0
"""Length of the wire between the terminals and the supply, in one direction [m]."""
_BENCH_SECTION = 1.5  # of that wire [mm2]
_FAN = 0.12  # width of a usual fan [m]
CRIMP = 8.0
"""Length of wire in a ferrule [mm]."""
_SPARE = 2  # fuses for each output


@dataclass(frozen=True)
class Item:
    """One line of the shopping list."""

    name: ItemName
    """Name, as in bom.csv."""
    purpose: str
    """Description with ratings."""
    count: int
    """Number of pieces; of wire, metres."""
    unit: str = ""
    """Unit of the count; empty: pieces."""


def circuits(c: Content, connections: Wiring) -> dict[int, Circuit]:
    """The heating circuit of each relay channel, by its number."""
    springs = spring_parameters(c.spec)
    limit = c.spec.coil.current_limit_a
    return {n.channel: Circuit(len(n.faces), springs, limit) for n in connections}


def parts_to_buy(c: Content) -> list[Item]:
    """What becomes part of the robot: coils, markers, shot."""
    spec, springs = c.spec, spring_parameters(c.spec)
    coil = spec.coil
    ends = math.ceil((spec.outside - spec.springs_at + coil.outer_diameter / 2 + CRIMP) / 5) * 5
    items = [
        Item(
            "shape_memory_spring",
            f"two-way Nitinol coil, {coil.cold_length:g} mm cold, {coil.hot_length:g} mm hot, "
            f"{coil.outer_diameter:g} mm outside; wire {1e3 * springs.wire_diameter:g} mm, mean diameter "
            f"{1e3 * springs.coil_diameter:g} mm, {springs.turns:g} turns, straight ends of {ends} mm; "
            f"austenite {springs.austenite_start:g} to {springs.austenite_finish:g} C, martensite "
            f"{springs.martensite_start:g} to {springs.martensite_finish:g} C; "
            f"{springs.resistance:.2f} Ohm and {1e3 * springs.mass:.2f} g without its ends",
            2 * c.assembly.morphology.motors,
        ),
        Item(
            "marker",
            f"m1 to m{len(c.assembly.marks)} of markers.pdf, on the front face; a disc is a little less than "
            f"its seat of {spec.mass.disc_diameter:g} mm",
            len(c.assembly.marks),
        ),
    ]
    if c.variant.ballast is not None:
        items.append(Item("ballast", f"steel shot, {c.filling:.2f} g into each ballast holder", 2))
    return items


def bench_items(c: Content, connections: Wiring, lead_mm: int) -> list[Item]:
    """What the bench needs, once for all robots. `lead_mm`: the longest lead to the top of the robot."""
    own = circuits(c, connections)
    widest = max(own.values(), key=lambda circuit: circuit.coils)  # their current is the same
    lowest = min(circuit.min_loaded_voltage for circuit in own.values())
    count, springs = len(own), widest.springs
    section, (ferrule, bore) = widest.lead_section, widest.ferrule
    heat = sum(circuit.current_limit**2 * circuit.resistance for circuit in own.values())
    input_power = 10 * math.ceil(
        sum(circuit.max_current * circuit.springs.supply_voltage for circuit in own.values()) / 10
    )
    length = 1e-3 * float(np.ptp(c.assembly.centres[:, 0]))
    coils = sum(circuit.coils for circuit in own.values())
    joined = coils - count  # pairs of coils in series, whose leads meet at the top of the robot
    lead_metres = math.ceil(2 * (1e-3 * coils * lead_mm + count * TO_TERMINALS))
    return [
        Item(
            "supply_output",
            f"output of {springs.supply_voltage:g} V DC with an adjustable current limit of its own, set to "
            f"{widest.current_limit:g} A; it gives {widest.max_current:.2f} A for any time. All together at "
            f"most {MAX_TOTAL_CURRENT_A:g} A and {heat:.0f} W of heat in the coils. Bench supplies, or "
            "limiter modules behind one DC supply",
            count,
        ),
        Item(
            "fuse",
            f"{widest.fuse:g} A quick-acting (F), 5 x 20 mm, with a holder and {_SPARE - 1} spare for each "
            "output",
            _SPARE * count,
        ),
        Item(
            "relay_board",
            f"USB relay board of a kind that eldir drives, {count} channels or more, contacts for "
            f"{CONTACT_RATING_A:g} A DC at {springs.supply_voltage:g} V or more",
            1,
        ),
        Item(
            "timer_relay",
            f"on-delay timer, contact closed at rest for {CONTACT_RATING_A:g} A DC, set to open between "
            f"{MAX_ON_S:g} and {TIMER_S:g} s. It has a supply of its own, and its control input must "
            f"recognise {lowest:.1f} to {springs.supply_voltage:g} V: an output in its current limit has "
            f"less than {springs.supply_voltage:g} V. Or a thermal cut-off on each coil (cutoff: thermal in "
            "the rig file)",
            count,
        ),
        Item(
            "main_switch",
            f"switch for the input of the heating supply, {input_power} W or more, within reach of whoever "
            "watches",
            1,
        ),
        Item(
            "fan",
            f"fan of {1e3 * _FAN:.0f} mm with a speed signal: {air_speed(springs):.1f} m/s of air at the "
            "coils, over the robot and one body length ahead of it",
            math.ceil(2 * length / _FAN),
        ),
        Item(
            "fan_interlock",
            f"relay for {input_power} W or more in the input of the heating supply; closes only while every "
            "fan turns (speed signal) or blows (vane switch). Without it leave `fan` out of the rig file",
            1,
        ),
        Item(
            "lead",
            f"stranded copper in silicone, {section:g} mm2 (AWG {awg(section)}), from coils to terminals: "
            f"{2 * count} pieces of {1e-3 * lead_mm + TO_TERMINALS:.2f} m"
            + (f", {2 * joined} of {1e-3 * lead_mm:.2f} m between coils in series" if joined else ""),
            lead_metres,
            "m",
        ),
        Item(
            "bench_wire",
            f"stranded copper, {_BENCH_SECTION:g} mm2 (AWG {awg(_BENCH_SECTION)}), between supply and "
            "terminals",
            math.ceil(2 * count * ON_BENCH),
            "m",
        ),
        Item(
            "ferrule",
            f"uninsulated copper ferrule of {ferrule:g} mm2, bore {bore:g} mm: joins a lead with a coil's "
            "end" + (", or two leads" if joined else ""),
            2 * coils + joined,
        ),
        Item("terminal", "pair of screw or spring terminals over the robot", count),
        Item(
            "test_resistor",
            f"wire-wound, {_dummy(widest):g} Ohm, {_power(widest):g} W or more: takes the place of a "
            "channel's coils in the tests",
            1,
        ),
    ]


def tools() -> list[str]:
    """Tools and consumables, by name."""
    return [
        "multimeter with a range of 200 mV or less, and one of 10 A",
        "crimping tool for the ferrules, wire stripper, side cutters",
        "calipers; balance that shows 0.01 g",
        "stopwatch; thermometer for the air",
        "gloves, glasses, solvents and UV lamp of the resin printer",
    ]


def lead_resistance(circuit: Circuit, lead_mm: int) -> float:
    """Resistance to expect of the leads between a channel's terminals and its coils, both ways [Ohm]."""
    length = 1e-3 * circuit.coils * lead_mm + TO_TERMINALS
    return 2 * STRAND_RESISTIVITY / circuit.lead_section * length


def bench_wire_resistance() -> float:
    """Resistance to expect of the wire between supply and terminals, both ways [Ohm]."""
    return 2 * STRAND_RESISTIVITY / _BENCH_SECTION * ON_BENCH


def _dummy(circuit: Circuit) -> float:
    """Resistance like that of the coils [Ohm], rounded to a half."""
    return max(round(2 * circuit.resistance) / 2, 0.5)


def _power(circuit: Circuit) -> float:
    """Rating of the test resistor [W]: twice the heat that it takes, in steps of 5 W."""
    return 5 * math.ceil(2 * circuit.max_current**2 * _dummy(circuit) / 5)
