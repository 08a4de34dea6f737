"""The fit coupon: sockets at steps of clearance, from which a workshop finds its printer's allowance.

Its gauges are a passive spring and a cap of the kit. Each socket and hole has a number. `coupon.csv` gives
the allowance of each number, for the printer's profile.
"""

from __future__ import annotations

from pathlib import Path

from manifold3d import Manifold

from eldir.core.files import new_folder, write_bytes, write_text
from eldir.core.pictures import csv_text
from eldir_cad.geometry.inspection import inspect, require_printable
from eldir_cad.geometry.parts import Part, cap, make_part, socket, strip
from eldir_cad.geometry.plates import nest
from eldir_cad.geometry.shapes import box, extrude, hexagon, number, stl
from eldir_cad.kit.printer import Printer, load_printer
from eldir_cad.kit.specification import Specification, load_specification

ALLOWANCE = "allowance_for_the_profile_mm"
"""Column of `coupon.csv`: what the printer's profile gets as `allowance`."""


def coupon_part(spec: Specification) -> Part:
    """A bar with one socket and one peg hole for each step of clearance, numbered from 1 [mm].

    It is printed on its floor, as the masses are.
    """
    m, steps = spec.mass, spec.coupon_steps
    advance, depth = 1.25 * m.across_flats, 1.5 * m.across_flats
    width = advance * len(steps)
    body = extrude(box(0, 0, width, depth), 0, m.height)
    cuts = Manifold()
    for i, clearance in enumerate(steps):
        x = (i + 0.5) * advance
        widened = spec.model_copy(update={"clearance": clearance})
        # Rotated to -y, as deep in the side of the bar as in that of a mass.
        opening = socket(widened).rotate(-90).translate((x, m.across_flats / 2))
        opening += hexagon(spec.connector.peg + 2 * clearance).translate((x, 0.75 * depth))
        cuts += extrude(opening, m.floor, m.height + 1)
        figure = number(i + 1, m.digit_height, m.stroke, 0).translate((x - 0.33 * advance, 0.5 * depth))
        cuts += extrude(figure, m.height - m.engraving_depth, m.height + 1)
    return make_part("fit_coupon", body - cuts, "fit coupon", "on its floor, sockets up")


def write_coupon(
    out: Path, specification: Specification | None = None, printer: Printer | None = None
) -> None:
    """Write the folder `out`, completely or not at all: parts, one plate, and coupon.csv with the
    allowances."""
    printer, spec = printer or load_printer(), specification or load_specification()
    parts = {p.name: p for p in (coupon_part(spec), strip(spec), cap(spec))}
    for part in parts.values():
        require_printable(part.name, part.mesh, inspect(part.mesh, printer), printer)
    plates = nest(parts, {"fit_coupon": 1, "passive_spring": 2, "cap": 2}, printer)
    with new_folder(out) as folder:
        for part in parts.values():
            write_bytes(folder / "parts" / f"{part.name}.stl", stl(part.mesh))
        for plate in plates:
            write_bytes(folder / "plates" / f"{plate.name}.3mf", plate.threemf())
            write_bytes(folder / "plates" / f"{plate.name}.stl", plate.stl())
        write_text(folder / "coupon.csv", allowance_table(spec))


def allowance_table(spec: Specification) -> str:
    """Number, clearance and allowance of each socket, as CSV [mm]."""
    steps = enumerate(spec.coupon_steps, start=1)
    rows = [(i, f"{clearance:.3f}", f"{clearance - spec.clearance:+.3f}") for i, clearance in steps]
    return csv_text(["number", "clearance_mm", ALLOWANCE], rows)
