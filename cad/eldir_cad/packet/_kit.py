"""The pages of kit.pdf: what a workshop prints and buys, how the bench is wired, what a meter must read."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from eldir.core.pictures import MOTOR
from eldir.parameters.bench import CONTACT_RATING_A, MAX_ON_S, RESISTANCE_TOLERANCE, TIMER_S
from eldir.parameters.springs import SpringParameters, max_still_air_temperature
from eldir.parameters.tolerances import RigTolerances
from eldir.parameters.wiring import Wiring
from eldir_cad.checks.strip_law import spring_parameters
from eldir_cad.kit.prices import Prices
from eldir_cad.packet._circuit import CURRENT_DENSITY, Circuit
from eldir_cad.packet._layout import Page
from eldir_cad.packet._wiring_diagram import draw_wiring
from eldir_cad.packet.cost import Cost, resin_to_have, total_cost
from eldir_cad.packet.manifest import Content
from eldir_cad.packet.shopping import (
    CRIMP,
    Item,
    bench_items,
    bench_wire_resistance,
    circuits,
    lead_resistance,
    parts_to_buy,
    tools,
)

TEST_CURRENT = 0.3
"""Current of the measurements [A]: at it a coil stays below its transition for any time."""
_MAX_DIFFERENCE = 0.02  # between the current limits of a motor's outputs, docs/reference/packet.md
_JOINT = 10e-3  # resistance of a good crimp [Ohm]
_FREE_WIRE = 5.0  # between spring end and ferrule [mm]
_FIND_COILS = "eldir rig doctor --rig rig.yaml --wiring --design design.json"
_MAX_LENGTH_DIFFERENCE = 2.0  # of a motor's hot coils [mm], docs/reference/second-physics-measured.md
_LIST = ((0.08, 22), (0.26, 84), (0.88, 8))
_PRICED_LIST = ((0.08, 22), (0.26, 68), (0.77, 8), (0.84, 14))
_CHECKS = ((0.08, 26), (0.28, 56), (0.68, 38))
_RECORD = (
    (0.08, 10), (0.15, 14), (0.24, 10), (0.34, 10), (0.44, 10), (0.54, 12), (0.64, 12), (0.75, 10), (0.85, 10)
)  # fmt: skip


def draw_kit(c: Content, connections: Wiring, lead_mm: int, prices: Prices | None = None) -> list[Figure]:
    """All pages. `lead_mm`: the longest lead to the top of the robot [mm]."""
    own = circuits(c, connections)
    longest = max(own.values(), key=lambda circuit: circuit.coils)
    return [
        *_draw_lists(c, connections, lead_mm, prices),
        *_draw_rules(c, longest, lead_mm),
        *draw_wiring(connections, own),
        *_draw_joints(c),
        *_draw_bench_work(longest),
        *_draw_measurements(connections, list(own.values()), lead_mm),
    ]


def _draw_lists(c: Content, connections: Wiring, lead_mm: int, prices: Prices | None) -> list[Figure]:
    page = Page("Kit: print and buy")
    page.heading("Print")
    page.list(_print_totals(c))
    for_robot, for_bench = parts_to_buy(c), bench_items(c, connections, lead_mm)
    for heading, items in (("For the robot", for_robot), ("For the bench, once", for_bench)):
        page.heading(heading)
        page.rows([_row(item, prices) for item in items], _LIST if prices is None else _PRICED_LIST)
    if prices is not None:
        page.heading("Cost")
        page.list(_describe_cost(c, total_cost(c, for_robot, for_bench, prices), prices))
    return page.figures


def _row(item: Item, prices: Prices | None) -> tuple[str, ...]:
    row = (item.name.replace("_", " "), item.purpose, f"{item.count} {item.unit}".strip())
    if prices is None:
        return row
    cost = prices.cost_of(item.name, item.count)
    return *row, "not known" if cost is None else f"{cost:.2f} {prices.currency}"


def _describe_cost(c: Content, cost: Cost, prices: Prices) -> list[str]:
    resin = ""
    if prices.resin_kg is not None:
        grams = resin_to_have(c)
        resin = f", of which {1e-3 * grams * prices.resin_kg:.2f} {cost.currency} for {grams:.1f} g of resin"
    lines = [f"Robot: {cost.describe(cost.robot)}{resin}.", f"Bench, once: {cost.describe(cost.bench)}."]
    if cost.unknown:
        names = ", ".join(name.replace("_", " ") for name in cost.unknown)
        lines.append(f"Without a price, and not in these sums: {names}.")
    return lines


def _print_totals(c: Content) -> list[str]:
    spring = 1e3 * spring_parameters(c.spec).mass
    coils = 2 * c.assembly.morphology.motors
    resin = 1e-3 * c.assembly.volume * c.printer.material.density
    content = [f"{resin:.2f} g of resin", f"{coils} coils of {spring:.2f} g"]
    if c.variant.ballast is not None:
        content.append(f"{2 * c.filling:.2f} g of shot")
    layers = ", ".join(f"{p.name} {p.height / c.printer.layer:.0f}" for p in (*c.plates, *c.ground_plates))
    return [
        f"{sum(c.assembly.counts.values())} parts on {len(c.plates)} plates: {1e-3 * c.assembly.volume:.2f} "
        f"cm3 of {c.printer.material.name}. {_describe_extra_resin(c)}",
        f"Layers of {c.printer.layer:g} mm, without supports: {layers}. {_describe_printing_time(c)}",
        f"Mass of the robot: {robot_mass(c):.2f} g ({', '.join(content)}), without markers, "
        "ferrules, leads and the straight ends of the coils.",
    ]


def _describe_extra_resin(c: Content) -> str:
    """Supports and losses by the printer's profile; without it, who knows them."""
    share = c.printer.extra_resin
    if share is None:
        come = "Supports, and resin that stays in the vat and on the parts, come to this"
        return f"{come}. They are not in the printer's profile (extra_resin); the slicer shows the supports."
    ground = "" if c.ground is None else " and ground"
    extra = f"{share:.0%} for supports and for what stays in the vat and on the parts"
    return f"With {extra}, have {resin_to_have(c):.1f} g ready for robot{ground}."


def _describe_printing_time(c: Content) -> str:
    """Time of all plates, one after the other, by the time of a layer; without it, who knows it."""
    seconds = c.printer.layer_s
    if seconds is None:
        known = "The time of a layer is not in the printer's profile (layer_s)"
        return f"{known}; the slicer shows the printing time."
    hours = sum(p.height for p in (*c.plates, *c.ground_plates)) / c.printer.layer * seconds / 3600
    return f"At {seconds:g} s a layer all plates take {hours:.1f} h, one after the other, without supports."


def robot_mass(c: Content) -> float:
    """Mass of the robot with its coils and its ballast [g], without markers, ferrules, leads and the straight
    ends of the coils."""
    resin = 1e-3 * c.assembly.volume * c.printer.material.density
    coils = 2 * c.assembly.morphology.motors * 1e3 * spring_parameters(c.spec).mass
    return resin + coils + (0.0 if c.variant.ballast is None else 2 * c.filling)


def _draw_rules(c: Content, circuit: Circuit, lead_mm: int) -> list[Figure]:
    page = Page("Kit: rules behind the list")
    page.heading("Ratings")
    current, limit = circuit.max_current, circuit.current_limit
    free = circuit.unlimited_current
    leads = lead_resistance(circuit, lead_mm) + bench_wire_resistance()
    page.list(
        [
            f"Current limit: {describe_current(c)}.",
            "Fuse: the smallest standard value that is not below the current limit with its tolerance, "
            f"{limit:g} A + {RigTolerances().current:.0%} = {current:.2f} A. It protects leads and contacts "
            f"from a short circuit. It does not protect a coil: if the limit of an output fails, {free:.1f} "
            f"A flow, {free / circuit.fuse:.2f} times the fuse's rating. A fuse of this kind carries 1.5 "
            "times its rating for an hour, and opens at 2.1 times within half an hour (IEC 60127-2, sheet "
            "2).",
            f"Lead: the smallest standard section that carries the fuse's rating at {CURRENT_DENSITY:g} "
            "A/mm2, single and in free air. Leads pull at the robot, so they are no thicker.",
            f"Contacts of relays and timers: {CONTACT_RATING_A:g} A, {CONTACT_RATING_A / current:.1f} times "
            "the largest current. A rating for AC is not one for DC.",
            f"Timer: not before the longest pulse, {MAX_ON_S:g} s, and not after {TIMER_S:g} s, with which "
            f"eldir checks the limits. In its current limit an output has {circuit.loaded_voltage:.1f} V, "
            "because the coils need no more: the control input of the timer must take this for on. "
            "No timer is needed where a coil that stays on never gets too hot (docs/safety.md).",
            "Ferrule: its bore has 1.5 times the section of the coil's wire and of the lead together.",
            "Fan: by the correlation for a wire across a stream, the speed that gives the coefficient with "
            f"which heat is predicted, {circuit.springs.convection_fan:g} W/(m2 K). Measure it: eldir "
            "calibrate springs.",
            f"Resistance to expect of leads and bench wire, both ways: {leads:.3f} Ohm; fuse and contacts "
            "come to this. Measure it, and write it into the rig file as supply.lead_resistance_ohm.",
        ]
    )
    page.heading("Tools")
    page.list(tools())
    page.heading("Not needed")
    glue = "A drop of the print's resin, cured with UV light, holds the connectors' pegs"
    if c.variant.ballast is not None:
        glue += "; a glue for plastics holds the ballast holders and their shot"
    page.list(
        [
            "Screws, nuts, magnets and bearings: parts are pressed into one another.",
            f"Other glue: {glue[0].lower()}{glue[1:]}. A glue stick holds the paper markers.",
            "Solder: it does not wet Nitinol, and its heat spoils the training of the coil.",
        ]
    )
    return page.figures


def describe_current(c: Content) -> str:
    """The current limit, and under which conditions it holds."""
    coil = c.spec.coil
    return ", ".join(part for part in (f"{coil.current_limit_a:g} A", coil.current_conditions) if part)


def _draw_joints(c: Content) -> list[Figure]:
    page = Page("Leads and coils")
    page.heading("How a lead joins Nitinol")
    figure_top = page.reserve(0.2)
    _draw_joint(page.figure, figure_top, spring_parameters(c.spec), c.spec.fitting.wire_guide)
    page.list(
        [
            "Do not solder. Do not bend the wire over an edge: Nitinol breaks where it was kinked.",
            f"Push the coil {c.spec.fitting.stud_length:g} mm over the stud of its spring end. Lead its "
            "straight end through the hole of the spring end, out of the robot.",
            f"Rub the last {CRIMP:g} mm of the wire bright with fine emery paper: its oxide insulates.",
            f"Strip {CRIMP:g} mm of the lead. Push strands and wire into the ferrule, beside each other over "
            "its whole length.",
            "Crimp twice with the tool for ferrules. Pull at the lead with the weight of 1 kg: nothing may "
            "move.",
            f"Leave {_FREE_WIRE:g} mm of wire between spring end and ferrule, so that it does not hinder the "
            "spring end when this turns. Cover the ferrule with silicone tube; no heat shrink: hot air "
            "heats the coil.",
            "Lead the wires upwards in a wide curve. Fix them to masses, never to passive springs or coils.",
        ]
    )
    page.heading("Before you begin with the bench")
    page.list(
        [
            "Read docs/safety.md. Software alone does not make heat safe: timers, interlock, current limits "
            "and main switch are yours to build and to test.",
            "Wiring of mains voltage is for an electrician. Limiter modules behind a closed DC supply need "
            "none.",
        ]
    )
    page.heading("When to stop")
    page.list(
        [
            "A reading is outside its bounds (measurements).",
            "A timer, the fan's interlock, a current limit or the main switch fails its test: no heat "
            "before all channels have passed it again.",
            "A coil was heated without its current limit: do not use it before its lengths, cold and hot, "
            "are those of the list.",
            "A mount, a socket or a spring end has moved, become soft or changed its colour; it smells of "
            "resin.",
            "A lead or a ferrule is hot to the touch; a fuse has opened.",
            "`eldir rig off` does not switch everything off: use the main switch, and look for the fault.",
        ]
    )
    return page.figures


def _draw_joint(figure: Figure, top: float, springs: SpringParameters, hole: float) -> None:
    """A section through spring end, wire, ferrule and lead; lengths along it in millimetres."""
    axes = figure.add_axes((0.08, top - 0.19, 0.84, 0.18))
    wire, begin = 1e3 * springs.wire_diameter, 6.0
    end = begin + _FREE_WIRE + CRIMP
    for low in (-2.5, hole / 2):
        axes.add_patch(Rectangle((2.8, low), 3.2, 2.5 - hole / 2, fc="#9db7c9", ec="black", lw=0.8))
    axes.add_patch(Rectangle((0.0, -wire / 2), end, wire, fc=MOTOR, ec="none", zorder=2))
    start = begin + _FREE_WIRE
    axes.add_patch(
        Rectangle((start, -0.9), CRIMP, 1.8, fc="#e9e2c8", ec="black", lw=1.0, alpha=0.8, zorder=1)
    )
    axes.add_patch(Rectangle((start, wire / 2), CRIMP + 2.5, 0.35, fc="#b87333", ec="none", zorder=3))
    axes.add_patch(Rectangle((end + 2.5, -0.3), 8.0, 1.4, fc="#dddddd", ec="black", lw=0.8, zorder=3))
    for x in (start + CRIMP / 4, start + 3 * CRIMP / 4):
        axes.annotate("", (x, 0.75), (x, 2.2), arrowprops={"arrowstyle": "-|>", "color": "black"}, zorder=5)
        axes.annotate("", (x, -0.75), (x, -2.2), arrowprops={"arrowstyle": "-|>", "color": "black"}, zorder=5)
    for left, right, text in ((begin, start, f"{_FREE_WIRE:g} mm"), (start, end, f"{CRIMP:g} mm")):
        axes.annotate("", (left, -2.9), (right, -2.9), arrowprops={"arrowstyle": "<->", "lw": 0.8})
        axes.text((left + right) / 2, -3.7, text, ha="center", va="center", fontsize=8)
    for x, y, text in (
        (4.4, 3.2, "spring end"),
        (1.2, 1.1, f"coil's wire\n{wire:g} mm"),
        (start + CRIMP / 2, 3.2, "ferrule, crimped twice"),
        (end + 6.5, 1.9, "lead"),
    ):
        axes.text(x, y, text, ha="center", va="center", fontsize=8)
    axes.set_xlim(-0.5, end + 11)
    axes.set_ylim(-4.2, 3.8)
    axes.axis("off")


def _draw_bench_work(circuit: Circuit) -> list[Figure]:
    limit, alike = circuit.current_limit, ""
    if circuit.coils == 1:
        spread = f"{_MAX_DIFFERENCE * limit:.2f} A ({_MAX_DIFFERENCE:.0%})"
        alike = f". The outputs of a motor's two coils may differ by {spread}"
    steps = [
        "Mount supply, main switch, interlock, fuses, relay board, timers and terminals as in the wiring "
        "diagram. Connect nothing to the terminals X",
        f"Set every output to {circuit.springs.supply_voltage:g} V without load. Short it through the "
        f"meter's range of 10 A and set its limit to {limit:g} A{alike}",
        "Interlock: stop each fan, one after the other: every output must fall to 0 V. Main switch: the same",
        "Timer, each channel: connect the test resistor to its terminals X, and bridge its relay contact "
        f"with a wire for 10 s. {limit:g} A must flow. The timer must open after {MAX_ON_S:g} to {TIMER_S:g} "
        "s, and stay open until the bridge is removed",
        "Fuse, each channel: take it out. With the contact bridged no current may flow",
        "Connect the relay board to the computer. Supply switched off: write the rig file with eldir rig "
        "setup --out rig.yaml; what is not measured yet is `unknown`. Then eldir rig doctor --rig rig.yaml "
        "--packet packet: the lines port, board and wiring must say ok",
        "Measure the resistance of the coils (next page)",
        "Write resistance, voltage, current limit and leads into the rig file, and cutoff and fan, which "
        "you have tested",
        "Hang the coils in the fan's air, clamped to their leads. Play a schedule with the heating supply "
        "switched off; then with heat, one hand at the main switch, and measure the lengths of the coils "
        "(next page). The two most alike belong to the same motor",
        "Build the robot by assembly.pdf. Join coils and leads; measure each joint",
        "Connect the leads to the terminals X by wiring.csv. Measure channels and isolation with the relays "
        "open",
        f"Fan on, supply on: {_FIND_COILS}. The coil that it names must become warm, and no other",
        "Play a schedule with the heating supply switched off; then with heat, one hand at the main switch",
    ]
    page = Page("Order of work on the bench")
    page.table([f"{i}. {step}" for i, step in enumerate(steps, start=1)])
    return page.figures


def _draw_measurements(connections: Wiring, own: Sequence[Circuit], lead_mm: int) -> list[Figure]:
    page = Page("Measurements")
    page.heading(f"At a test current of {TEST_CURRENT:g} A")
    springs, tolerance = own[0].springs, RESISTANCE_TOLERANCE
    warm = max_still_air_temperature(springs, TEST_CURRENT**2 * springs.resistance)
    page.list(
        [
            "The leads of a multimeter have a tenth of an ohm: for 1 Ohm, let a known current flow and "
            f"measure the voltage. Set an output to {TEST_CURRENT:g} A; 1 mV is then {1 / TEST_CURRENT:.1f} "
            f"mOhm. A coil may stay at this current: in still air of {springs.ambient:g} C it settles at "
            f"{warm:.0f} C at most, and begins to change its phase at {springs.austenite_start:g} C.",
            "The mean of the coils goes into the rig file as springs.resistance_ohm. A coil that differs "
            f"from it by more than {tolerance:.0%} is not used.",
        ]
    )
    page.heading("Which coils belong to the same motor")
    page.list(
        [
            "Where the two coils of a motor differ in length when they are hot, the robot turns and walks "
            "less. Measure them before you build; buy four more than the robot has, to choose from.",
            "Fan on, the coils clamped to their leads and hanging loose in its air, all at one height. "
            f"Let {_FIND_COILS} find them, then play the robot's schedule with eldir rig drive; key f ends "
            "it after one cycle.",
            "Measure each coil of channel 1 cold and at the end of its pulse, to 0.5 mm, in photographs "
            "beside a ruler. Exchange it for the next one until all were heated by channel 1.",
            "Mark the coils on squared paper, the cold length to the right and the hot one upwards. Those "
            f"nearest to each other belong to a motor; not more than {_MAX_LENGTH_DIFFERENCE:g} mm apart.",
        ]
    )
    page.heading("What the meter must read")
    page.rows(_readings(own, lead_mm), _CHECKS)
    page.heading("Record")
    measured = ["coil [mV]", "cold [mm]", "hot [mm]", "joints [mV]", "channel [mV]", "timer [s]", "limit [A]"]
    rows = [("channel", "coil", *measured)]
    for connection in connections:
        for face in connection.faces:
            name = f"S{connection.spring} {face}"
            rows.append((str(connection.channel), name, *["_" * 9] * len(measured)))
    page.rows(rows, _RECORD)
    page.list(["Air: _______ C     isolation: _______ MOhm     interlock: _______     main switch: _______"])
    return page.figures


def _readings(own: Sequence[Circuit], lead_mm: int) -> list[tuple[str, str, str]]:
    """What is measured, how, and what the meter must read."""
    ohm = own[0].springs.resistance
    bounds = [ohm * (1 - RESISTANCE_TOLERANCE), ohm * (1 + RESISTANCE_TOLERANCE)]
    rows = [
        ("what", "how", "must read"),
        ("coil, cold", "voltage from its first to its last turn", _in_bounds(*bounds)),
        (
            "joint",
            "voltage from the wire to the lead, both beside the ferrule",
            f"at most {1e3 * TEST_CURRENT * _JOINT:.0f} mV ({1e3 * _JOINT:.0f} mOhm)",
        ),
    ]
    for coils in sorted({circuit.coils for circuit in own}):
        leads = next(lead_resistance(circuit, lead_mm) for circuit in own if circuit.coils == coils)
        extra = leads + 2 * coils * _JOINT
        which = "channel" if coils == 1 else f"channel with {coils} coils"
        at_terminals = _in_bounds(coils * bounds[0], coils * bounds[1] + extra)
        rows.append((which, "voltage at its terminals X", at_terminals))
    return [
        *rows,
        (
            "isolation",
            "ohmmeter, nothing connected to the terminals X but the robot: each channel against each other, "
            "and against the table",
            "more than 1 MOhm",
        ),
        ("fuse", "ohmmeter over its holder; read its cap", f"less than 0.2 Ohm; F {own[0].fuse:g} A"),
        ("relay contact, at rest", "ohmmeter, supply switched off", "open"),
        ("timer contact, at rest", "ohmmeter, supply switched off", "closed, less than 0.1 Ohm"),
        ("timer", "stopwatch; test resistor, contact bridged", f"opens after {MAX_ON_S:g} to {TIMER_S:g} s"),
    ]


def _in_bounds(low: float, high: float) -> str:
    """A resistance [Ohm], as the voltage at the test current too."""
    return (
        f"{1e3 * TEST_CURRENT * low:.0f} to {1e3 * TEST_CURRENT * high:.0f} mV ({low:.2f} to {high:.2f} Ohm)"
    )
