"""The content of a packet: parts that are modelled, measured, placed and nested on plates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from eldir.design import Design, Variant
from eldir.errors import EldirError, InputError
from eldir_cad.checks.violations import BuildReport
from eldir_cad.geometry.assembly import Assembly, assemble, tightest
from eldir_cad.geometry.inspection import Inspection, inspect, require_printable
from eldir_cad.geometry.parts import holder
from eldir_cad.geometry.plates import Plate, nest
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification

_ROUNDING = 0.98  # of the clearance that placed parts must keep: circles are polygons


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


def make(
    built: Design, report: BuildReport, spec: Specification, printer: Printer, variant: Variant
) -> Content:
    """Make all parts. Raises `EldirError` for a part that cannot be printed or parts that do not fit
    together."""
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
    gap = tightest(assembly)
    if gap[0] < _ROUNDING * spec.clearance:
        raise EldirError(
            f"{gap[1]} and {gap[2]} do not fit together",
            code="part.no-clearance",
            expected=f"{spec.clearance:g} mm between them",
            found=f"{gap[0]:.3f} mm",
            remedy="check the dimensions in the specification",
        )
    plates = nest(assembly.parts, assembly.counts, printer)
    return Content(built, assembly, inspections, gap, plates, report, spec, printer, variant, filling)
