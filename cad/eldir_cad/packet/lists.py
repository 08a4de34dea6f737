"""The packet's tables, as CSV: bill of materials and wiring."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

import numpy as np

from eldir.parameters.wiring import Wiring
from eldir_cad.checks.contacts import Lead
from eldir_cad.packet.content import Content

SLACK = 100.0  # of a lead, beyond the way to the top of the robot [mm]


def bill_of_materials(c: Content) -> str:
    """Printed parts, then purchased parts."""
    density = c.printer.material.density * 1e-3  # g/mm3
    rows: list[list[object]] = []
    for name, count in c.assembly.counts.items():
        part = c.assembly.parts[name]
        size = [f"{part.volume:.1f}", f"{part.volume * density:.3f}"]
        how = [part.pose, c.inspections[name].supports]
        rows.append([name, part.purpose, count, *size, f"{name}.stl", *how])
    coil = c.spec.coil
    bought: list[tuple[str, str, int]] = [
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
        bought.append(("ballast", f"steel shot, {c.filling:.2f} g into each ballast holder", 2))
    rows += [[name, purpose, count, "", "", "", "", ""] for name, purpose, count in bought]
    header = ["part", "purpose", "count", "volume_mm3", "weight_g", "file", "printed", "supports"]
    return _csv(header, rows)


def wiring(c: Content, connections: Wiring, leads: Sequence[Lead]) -> str:
    """The relay channel of each spring. The resistance must be measured."""
    body = c.assembly.morphology
    motors = np.flatnonzero(body.active)
    longest = [max(lead.length for lead in leads if lead.motor == m) for m in range(len(motors))]
    rows: list[list[object]] = [
        [
            wired.spring,
            motors[wired.spring],
            wired.face,
            *body.springs[motors[wired.spring]],
            wired.channel,
            "",
            c.spec.coil.current_limit_a,
            round(longest[wired.spring] + SLACK),
        ]
        for wired in connections
    ]
    header = ["spring", "spring_in_design", "face", "mass_a", "mass_b", "relay_channel"]
    return _csv([*header, "resistance_ohm_measured", "current_limit_a", "lead_to_top_mm"], rows)


def _csv(header: list[str], rows: list[list[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
