"""The content of a packet: parts that are modelled, measured, placed and nested on plates, and their tables
(CSV)."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eldir.design import Design, Variant
from eldir.errors import EldirError, InputError
from eldir.parameters.wiring import Wiring
from eldir_cad.checks.contacts import Lead
from eldir_cad.checks.violations import BuildReport
from eldir_cad.geometry.assembly import Assembly, assemble, smallest_gap
from eldir_cad.geometry.ground import Ground, make_ground
from eldir_cad.geometry.inspection import Inspection, inspect, require_printable
from eldir_cad.geometry.parts import holder
from eldir_cad.geometry.plates import Plate, nest
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification

_MIN_CLEARANCE = 0.98  # of the specified clearance, between placed parts: circles are polygons
SLACK = 100.0  # of a lead, beyond its length to the top of the robot [mm]


@dataclass(frozen=True, eq=False)
class Content:
    """A robot that can be printed and assembled."""

    built: Design
    assembly: Assembly
    inspections: Mapping[str, Inspection]
    gap: tuple[float, str, str]
    plates: list[Plate]
    report: BuildReport
    spec: Specification
    printer: Printer
    variant: Variant
    filling: float
    """Weight of the shot in each ballast holder [g]."""
    ground: Ground | None
    """The ground under the robot; None: a table."""
    ground_plates: list[Plate]


def make_content(
    built: Design, report: BuildReport, spec: Specification, printer: Printer, variant: Variant
) -> Content:
    """Model and inspect all parts, and nest them on plates. Raises `EldirError` for a part that cannot be
    printed, or parts that do not fit together."""
    ballast, filling = None, 0.0
    if variant.ballast is not None:
        mass = variant.ballast.mass
        if mass in built.marks:
            raise InputError(
                f"the ballast would hide the disc on mass {mass}",
                code="ballast.hides-disc",
                expected="a mass that is not one of m1 to m5",
                found=f"m{built.marks.tolist().index(mass) + 1}",
            )
        part, filling = holder(spec, variant.ballast.grams / 2, printer.material.density)
        ballast = (mass, part)
    assembly = assemble(built.morphology, spec, built.marks, ballast)
    inspections = {name: inspect(part.mesh, printer) for name, part in assembly.parts.items()}
    for name, part in assembly.parts.items():
        require_printable(name, part.mesh, inspections[name], printer)
    gap = smallest_gap(assembly)
    if gap[0] < _MIN_CLEARANCE * spec.clearance:
        raise EldirError(
            f"{gap[1]} and {gap[2]} do not fit together",
            code="part.no-clearance",
            expected=f"{spec.clearance:g} mm between them",
            found=f"{gap[0]:.3f} mm",
            remedy="check the dimensions in the specification",
        )
    plates = nest(assembly.parts, assembly.counts, printer)
    ground = _make_ground(built, assembly, spec, printer)
    ground_plates = [] if ground is None else _nest_ground(ground, printer)
    return Content(
        built,
        assembly,
        inspections,
        gap,
        plates,
        report,
        spec,
        printer,
        variant,
        filling,
        ground,
        ground_plates,
    )


def _make_ground(built: Design, assembly: Assembly, spec: Specification, printer: Printer) -> Ground | None:
    if built.printed_terrain is None:
        return None
    across = [
        float((assembly.parts[p.part].mesh.bounds @ np.asarray(p.rotation).T)[i, 2] + p.translation[2])
        for p in assembly.placements
        for i in range(2)
    ]
    positions = 1e-3 * assembly.centres
    depth = max(across) - min(across)
    return make_ground(built.printed_terrain, positions, depth, spec.clearance, printer)


def _nest_ground(ground: Ground, printer: Printer) -> list[Plate]:
    """Plates of their own: a robot is printed without its ground too."""
    parts = {piece.part.name: piece.part for piece in ground.pieces}
    plates = nest(parts, dict.fromkeys(parts, 1), printer)
    return [replace(plate, name=f"ground_{plate.name}") for plate in plates]


def bill_of_materials(c: Content) -> str:
    """Printed parts, then purchased parts, as CSV."""
    density = c.printer.material.density * 1e-3  # g/mm3
    rows: list[list[object]] = []
    for name, count in c.assembly.counts.items():
        part = c.assembly.parts[name]
        size = [f"{part.volume:.1f}", f"{part.volume * density:.3f}"]
        printing = [part.pose, c.inspections[name].supports]
        rows.append([name, part.purpose, count, *size, f"{name}.stl", *printing])
    for piece in () if c.ground is None else c.ground.pieces:
        part = piece.part
        size = [f"{part.volume:.1f}", f"{part.volume * density:.3f}"]
        rows.append([part.name, part.purpose, 1, *size, f"{part.name}.stl", part.pose, "none"])
    coil = c.spec.coil
    purchased: list[tuple[str, str, int]] = [
        (
            "shape_memory_spring",
            f"two-way Nitinol coil, {coil.cold_length:g} mm cold, {coil.hot_length:g} mm hot, "
            f"{coil.outer_diameter:g} mm outside",
            2 * c.assembly.morphology.motors,
        ),
        (
            "tracking_disc",
            f"coloured disc for m1 to m5 on the front face, a little less than its seat of "
            f"{c.spec.mass.disc_diameter:g} mm",
            len(c.assembly.marks),
        ),
    ]
    if c.variant.ballast is not None:
        purchased.append(("ballast", f"steel shot, {c.filling:.2f} g into each ballast holder", 2))
    rows += [[name, purpose, count, "", "", "", "", ""] for name, purpose, count in purchased]
    header = ["part", "purpose", "count", "volume_mm3", "weight_g", "file", "printed", "supports"]
    return _csv(header, rows)


def wiring_table(c: Content, connections: Wiring, leads: Sequence[Lead]) -> str:
    """The relay channel of each spring, as CSV. The column of the resistance is left empty, to be filled
    in."""
    body = c.assembly.morphology
    motors = np.flatnonzero(body.active)
    longest = [max(lead.length for lead in leads if lead.motor == m) for m in range(len(motors))]
    rows: list[list[object]] = [
        [
            connection.spring,
            motors[connection.spring],
            connection.face,
            *body.springs[motors[connection.spring]],
            connection.channel,
            "",
            c.spec.coil.current_limit_a,
            round(longest[connection.spring] + SLACK),
        ]
        for connection in connections
    ]
    header = ["spring", "spring_in_design", "face", "mass_a", "mass_b", "relay_channel"]
    return _csv([*header, "resistance_ohm_measured", "current_limit_a", "lead_to_top_mm"], rows)


def _csv(header: list[str], rows: list[list[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
