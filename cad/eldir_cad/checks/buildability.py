"""The build filter: the reasons why a design cannot be built, or would not stand on the table.

Each kind of violation has its own check below; `eldir_cad.checks.violations` has the records of the results.
"""

from __future__ import annotations

from collections import Counter
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from eldir.built.robot import PrintedRobot, build, count_mechanisms, find_held_motors, static_margin
from eldir.core.records import FloatArray
from eldir.design import marked_masses
from eldir.lattice import HALF_SIDE
from eldir.morphology import Morphology
from eldir.parameters.springs import SpringParameters
from eldir_cad.checks.contacts import Lead, find_contacts, find_leads
from eldir_cad.checks.kinematics import (
    AT_REST,
    Stroke,
    degrees_of_freedom,
    find_hinges,
    foot_stroke,
    max_shortening,
    simulate_stroke,
    socket_turns,
)
from eldir_cad.checks.kit_differences import note_differences
from eldir_cad.checks.strip_law import StripLaw, built_parameters, spring_parameters
from eldir_cad.checks.tipping import (
    CURRENT_SPREAD,
    REQUIRED_MARGIN_DEG,
    centre_height,
    smallest_gap,
    tipping_angle,
    twist_angle,
)
from eldir_cad.checks.violations import BuildReport, Severity, Violation
from eldir_cad.geometry.parts import (
    cap,
    connector,
    engraved_volume,
    fitting,
    mass_volume,
    seat_volume,
    strip,
)
from eldir_cad.geometry.plates import Size, count_plates
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification

_MAX_LISTED = 3  # violations of a kind that are listed one by one
_CheckResult = tuple[list[Violation], dict[str, float]]


class CheckedBody(NamedTuple):
    """A body after the checks."""

    report: BuildReport
    leads: list[Lead]
    """The wires of its motors, as in `find_leads`; empty for a refused body."""


def check(
    morphology: Morphology,
    spec: Specification,
    printer: Printer,
    springs: SpringParameters | None = None,
    ballast: FloatArray | float = 0.0,
) -> BuildReport:
    """Check whether a body can be printed, assembled and driven, and whether it stands.

    `springs`: of a rig, instead of the coils of the specification. `ballast` of one plane [kg], as
    `eldir.built.robot.build` takes it. A refused body is not checked further, because the simulation of its
    motion may take long.
    """
    return check_with_leads(morphology, spec, printer, springs, ballast).report


def check_with_leads(
    morphology: Morphology,
    spec: Specification,
    printer: Printer,
    springs: SpringParameters | None = None,
    ballast: FloatArray | float = 0.0,
) -> CheckedBody:
    """As `check`, with the wires that it found in the simulated motion."""
    given = spec
    if springs is None:
        springs = spring_parameters(spec)
    else:
        spec = spec.with_coil(springs)
    violations = [*_check_workspace(morphology, spec), *_check_motors(morphology, spec)]
    figures: dict[str, float] = {}
    leads: list[Lead] = []
    if not violations:
        law = StripLaw.of(spec, printer)
        motion = simulate_stroke(morphology, spec, law, springs)
        leads = find_leads(motion, morphology, spec)
        robot = build(morphology, built_parameters(spec, printer, springs), ballast=ballast)
        for new_violations, values in (
            _check_hinges(morphology, spec),
            _check_mechanisms(morphology, spec),
            _check_coils(morphology, spec, springs),
            _check_collisions(motion, morphology, spec),
            _check_strains(motion, morphology, spec, printer, law),
            _check_socket_turns(motion, morphology, spec),
            _check_stability(motion, robot, spec),
            _check_tipping(robot, spec),
            _check_leads(leads, motion, morphology, spec),
            (note_differences(given, printer), {}),
            _count_parts(morphology, spec, printer, springs.mass),
        ):
            violations += new_violations
            figures |= {name: round(float(value), 6) for name, value in values.items()}
    return CheckedBody(BuildReport.of(violations, figures), leads)


def _check_workspace(morphology: Morphology, spec: Specification) -> list[Violation]:
    width, height = np.ptp(morphology.positions, axis=0) / HALF_SIDE
    rows, columns = round(height / np.sqrt(3)), round(width) - 1
    limit = spec.workspace
    excess = max(rows - limit.rows, columns - limit.columns)
    if excess <= 0:
        return []
    message = (
        f"the body fills {rows} x {columns} triangles (rows x columns); the workspace is "
        f"{limit.rows} x {limit.columns}"
    )
    remedy = f"evolve in this workspace: eldir evolve --lattice {limit.rows}x{limit.columns}"
    return [Violation("workspace", "refused", ("body",), excess, "triangles", message, remedy)]


def _check_motors(morphology: Morphology, spec: Specification) -> list[Violation]:
    allowed, motors = spec.workspace.motors, morphology.motors
    names = tuple(f"spring {i}" for i in np.flatnonzero(morphology.active))
    if motors == 0:
        message, excess = "the body has no active spring, so it cannot move", 1
    elif motors > allowed:
        message = f"the body has {motors} active springs; at most {allowed} can be built"
        excess = motors - allowed
    else:
        return []
    remedy = f"evolve with motors: eldir evolve --max-motors {allowed}"
    return [Violation("motors", "refused", names, excess, "springs", message, remedy)]


def _check_hinges(morphology: Morphology, spec: Specification) -> _CheckResult:
    hinges = find_hinges(morphology)
    violations = []
    for hinge in hinges:
        rest = "nothing else joins them" if hinge.separates else "they are also joined elsewhere"
        message = f"mass {hinge.mass} is a hinge between {hinge.parts} parts of the body; {rest}"
        remedy = _remedy(spec, "watch the play of its sockets")
        violations.append(
            Violation("hinge", "note", (f"mass {hinge.mass}",), hinge.parts, "parts", message, remedy)
        )
    return violations, {"hinges": len(hinges)}


def _check_mechanisms(morphology: Morphology, spec: Specification) -> _CheckResult:
    at, springs = morphology.positions, morphology.springs
    free = degrees_of_freedom(at, springs)
    figures: dict[str, float] = {
        "freedoms": free,
        "freedoms_generic": count_mechanisms(at, springs),
        # These are what the motors drive: a body without any is rigid and hardly moves.
        "freedoms_without_motors": degrees_of_freedom(at, springs[~morphology.active]),
    }
    violations = []
    if free:
        clamped = spec.strip.turn_deg == 0
        message = f"with all its springs the body can still fold in {free} way(s), until its sockets stop it"
        if clamped:
            message = f"only its clamped strips keep the body from folding in {free} way(s)"
        severity: Severity = "note" if clamped else "unfit"
        remedy = _remedy(spec, "choose another design, or print clamped strips: strip.turn_deg 0")
        violations.append(
            Violation("mechanism", severity, ("body",), free, "degrees of freedom", message, remedy)
        )
    if figures["freedoms_without_motors"] == 0:
        violations.append(
            Violation(
                "rigid",
                "unfit",
                tuple(f"spring {i}" for i in np.flatnonzero(morphology.active)),
                1,
                "degrees of freedom",
                "the passive springs alone make the body rigid: its motors can deform it only by millimetres",
                "choose a design that its motors can deform",
            )
        )
    return violations, figures


def _check_coils(morphology: Morphology, spec: Specification, springs: SpringParameters) -> _CheckResult:
    """Coils that have less room between fixed masses than they need when hot."""
    fixed = find_held_motors(morphology.positions, morphology.springs, morphology.active)
    shorter = springs.hot_length - 1e-3 * spec.pitch
    buckles = float(springs.buckling_shortening(np.array(springs.hot_length)))
    violations = []
    if len(fixed) and shorter > buckles:
        names = tuple(f"spring {i}" for i in fixed)
        message = (
            f"strips hold the masses at both ends of {', '.join(names)}: hot, the coil is "
            f"{1e3 * shorter:.0f} mm too long for its place; it buckles at {1e3 * buckles:.1f} mm"
        )
        remedy = "choose a design whose motors can all move"
        ratio = shorter / buckles
        violations.append(
            Violation("coil", "unfit", names, ratio, "times the shortening at buckling", message, remedy)
        )
    return violations, {"held_motors": len(fixed), "coil_buckling_mm": 1e3 * buckles}


def _remedy(spec: Specification, otherwise: str) -> str:
    return "seat its strips without play" if spec.strip.turn_deg == 0 else otherwise


def _check_collisions(motion: Stroke, morphology: Morphology, spec: Specification) -> _CheckResult:
    contacts = find_contacts(motion, morphology, spec)
    violations = []
    for contact in contacts[:_MAX_LISTED]:
        one, other = contact.parts
        missing = spec.clearance - contact.gap
        remedy = "choose another design"
        if contact.pose != AT_REST:
            remedy = "heat for less time, or choose another design"
        message = f"{one} and {other} need {missing:.1f} mm more clearance, {contact.pose}"
        violations.append(Violation("collision", "unfit", contact.parts, missing, "mm", message, remedy))
    return violations, {"collisions": len(contacts)}


def _check_strains(
    motion: Stroke, morphology: Morphology, spec: Specification, printer: Printer, law: StripLaw
) -> _CheckResult:
    """Bending of the strips at the greatest shortening of all combinations of hot motors."""
    allowed = printer.material.strain_limit / spec.safety.strain
    short = max_shortening(motion, morphology)
    passive = np.flatnonzero(~morphology.active).tolist()
    strains = {i: law.surface_strain(min(float(short[i]), 0.9 * law.length)) for i in passive}
    order = sorted(strains, key=lambda i: -strains[i])
    violations = []
    for i in order[:_MAX_LISTED]:
        if strains[i] > allowed:
            message = (
                f"spring {i} is shortened by {short[i]:.1f} mm: its surface strain is {strains[i]:.1%}, "
                f"{allowed:.1%} is allowed"
            )
            by = strains[i] / allowed
            remedy = "heat for less time, or print thinner strips"
            violations.append(
                Violation(
                    "strain", "unfit", (f"spring {i}",), by, "times the allowed strain", message, remedy
                )
            )
    return violations, {"greatest_strain": strains[order[0]] if order else 0.0}


def _check_socket_turns(motion: Stroke, morphology: Morphology, spec: Specification) -> _CheckResult:
    """Springs that rotate further than their sockets allow: the simulation, with pins, is then wrong."""
    turns = np.degrees(socket_turns(motion, morphology))
    worst, allowed = int(turns.argmax()), spec.strip.turn_deg
    figures = {"greatest_turn_deg": float(turns[worst])}
    if allowed == 0 or turns[worst] <= allowed:
        return [], figures
    message = (
        f"in the full stroke the springs at mass {worst} rotate by {turns[worst]:.0f} degrees, their sockets "
        f"allow {allowed:g}: then strips bend, and the stroke is smaller than predicted"
    )
    remedy = "heat for less time, or print wider sockets: strip.turn_deg"
    by = float(turns[worst] - allowed)
    return [Violation("turn", "note", (f"mass {worst}",), by, "degrees", message, remedy)], figures


def _check_stability(motion: Stroke, robot: PrintedRobot, spec: Specification) -> _CheckResult:
    margin = 1e3 * static_margin(robot)
    spread = foot_stroke(motion)
    violations = []
    required, safe = spec.safety.static_margin, spec.safety.static_margin_safe
    where = f"its centre of mass lies {margin:.0f} mm inside its feet"
    remedy = "choose a design with feet further apart"
    if margin < required:
        message = f"{where}, {required:.0f} mm are required: the robot may fall over"
        violations.append(
            Violation("static margin", "unfit", ("feet",), required - margin, "mm", message, remedy)
        )
    elif margin < safe:
        message = f"{where}; one in four of such robots falls over, but hardly any with {safe:.0f} mm"
        violations.append(Violation("static margin", "note", ("feet",), safe - margin, "mm", message, remedy))
    if spread < spec.safety.foot_stroke:
        message = (
            f"the motors change the distances of the feet by at most {spread:.1f} mm; bodies with less than "
            f"{spec.safety.foot_stroke:g} mm hardly ever walk"
        )
        by = spec.safety.foot_stroke - spread
        violations.append(Violation("feet", "note", ("feet",), by, "mm", message, "choose another design"))
    return violations, {"static_margin_mm": margin, "foot_stroke_mm": spread}


def _check_tipping(robot: PrintedRobot, spec: Specification) -> _CheckResult:
    """Whether springs of the faces that are heated unlike can tip the robot over sideways."""
    height = centre_height(robot, spec)
    tips, twist = tipping_angle(spec, height), twist_angle(spec)
    margin = tips - twist
    violations = []
    if margin < REQUIRED_MARGIN_DEG:
        message = (
            f"the robot tips sideways at {tips:.0f} degrees, and faces whose currents differ by "
            f"{CURRENT_SPREAD:.0%} to either side twist it by {twist:.0f}: the margin is {margin:.1f} "
            f"degrees, {REQUIRED_MARGIN_DEG:g} are required"
        )
        gap = smallest_gap(spec, height)
        remedy = "choose a lower design"
        if gap is not None:
            remedy = f"print connectors for a gap of {gap} mm (connector.gap in the parts file), or {remedy}"
        severity: Severity = "unfit" if margin < 0 else "note"
        missing = REQUIRED_MARGIN_DEG - margin
        violations.append(Violation("sideways", severity, ("body",), missing, "degrees", message, remedy))
    return violations, {"tipping_angle_deg": tips, "sideways_margin_deg": margin}


def _check_leads(
    leads: list[Lead], motion: Stroke, morphology: Morphology, spec: Specification
) -> _CheckResult:
    """Whether both leads of every motor can leave outwards, and do not touch the table."""
    ground = 1e-6 + float(motion.rest[:, 1].min())
    violations = []
    for lead in leads:
        if lead.clearance < spec.clearance:
            missing = spec.clearance - lead.clearance
            message = (
                f"the lead of S{lead.motor} at mass {lead.mass} needs {missing:.1f} mm more room beside "
                f"{lead.nearest}"
            )
            parts = (f"S{lead.motor}", lead.nearest)
            remedy = "heat for less time, or choose another design"
            violations.append(Violation("wire", "unfit", parts, missing, "mm", message, remedy))
    for motor, (a, b) in enumerate(morphology.springs[morphology.active].tolist()):
        if motion.rest[[a, b], 1].max() <= ground:
            message = f"S{motor} lies on the table: the robot may drag its leads along"
            remedy = "fix its leads to the masses above"
            violations.append(Violation("wire", "note", (f"S{motor}",), 0.0, "mm", message, remedy))
    return violations, {"longest_lead_mm": max(lead.length for lead in leads)}


def _count_parts(morphology: Morphology, spec: Specification, printer: Printer, coil: float) -> _CheckResult:
    """Printed parts and plates of both planes, their resin without supports, and the robot's weight.
    `coil`: mass of one [kg]."""
    degree = Counter(morphology.springs.ravel().tolist()).values()
    masses, full = len(degree), sum(n == 6 for n in degree)
    motors = morphology.motors
    volumes, sizes = _kit(spec)
    counts = {
        "passive_spring": 2 * (len(morphology.springs) - motors),
        "spring_end": 4 * motors,
        "connector": masses - full,
        "cap": 2 * full,
        "mass": 2 * masses,
    }
    volume = sum(volumes[name] * n for name, n in counts.items() if name != "mass")
    volume += 2 * sum(mass_volume(spec, sockets) for sockets in degree)
    volume -= _engraved(spec, masses) + len(marked_masses(morphology)) * seat_volume(spec)
    resin = volume * 1e-3 * printer.material.density
    return [], {
        "masses": masses,
        "motors": motors,
        "parts": sum(counts.values()),
        "plates": count_plates(sizes, counts, printer),
        "resin_mm3": round(volume, 1),
        "resin_g": round(resin, 2),
        "robot_g": round(resin + 2 * motors * 1e3 * coil, 2),
    }


_engraved = lru_cache(maxsize=64)(engraved_volume)


@lru_cache(maxsize=8)
def _kit(spec: Specification) -> tuple[dict[str, float], dict[str, Size]]:
    """Volumes and sizes of the parts. The volume of a mass depends on its sockets (`mass_volume`)."""
    parts = {p.name: p for p in (strip(spec), fitting(spec), connector(spec), cap(spec))}
    sizes: dict[str, Size] = {}
    for name, part in parts.items():
        x, y, z = (float(e) for e in part.mesh.extents)
        sizes[name] = (x, y, z)
    sizes["mass"] = (spec.mass.across_flats, spec.mass.across_corners, spec.mass.height)
    return {name: part.volume for name, part in parts.items()}, sizes
