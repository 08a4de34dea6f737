"""Tables of a packet as CSV: what to print and to buy, and which relay channel heats which spring."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eldir.core.pictures import csv_text
from eldir.parameters.wiring import Wiring
from eldir_cad.checks.contacts import Lead
from eldir_cad.kit.prices import Prices
from eldir_cad.packet.cost import total_volume
from eldir_cad.packet.manifest import Content
from eldir_cad.packet.shopping import Item

SLACK = 100.0  # of a lead, beyond its length to the top of the robot [mm]


def lead_lengths(leads: Sequence[Lead]) -> dict[int, int]:
    """Length that a lead needs to reach the top of the robot, with some slack [mm], by motor."""
    motors = {lead.motor for lead in leads}
    return {m: round(max(lead.length for lead in leads if lead.motor == m) + SLACK) for m in sorted(motors)}


def bill_of_materials(c: Content, bought: Sequence[Item], prices: Prices | None = None) -> str:
    """Printed parts, then what is bought for robot and bench, as CSV; with `prices` what each row costs."""
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
    if c.printer.extra_resin is not None:
        volume = total_volume(c) * c.printer.extra_resin
        size = [f"{volume:.1f}", f"{volume * density:.3f}"]
        rows.append(["extra_resin", "of supports; stays in the vat and on the parts", 1, *size, "", "", ""])
    printed = len(rows)
    for item in bought:
        purpose = item.purpose + (f"; count in {item.unit}" if item.unit else "")
        rows.append([item.name, purpose, item.count, "", "", "", "", ""])
    header = ["part", "purpose", "count", "volume_mm3", "weight_g", "file", "printed", "supports"]
    if prices is not None:
        header.append(f"price_{prices.currency}")
        for row in rows[:printed]:
            weight = float(str(row[4])) * int(str(row[2]))
            row.append("" if prices.resin_kg is None else f"{1e-3 * weight * prices.resin_kg:.2f}")
        for row, item in zip(rows[printed:], bought, strict=True):
            each = prices.items.get(item.name)
            row.append("" if each is None else f"{item.count * each:.2f}")
    return csv_text(header, rows)


def wiring_table(c: Content, connections: Wiring, leads: Sequence[Lead]) -> str:
    """The relay channel of each spring, as CSV. The column of the resistance is left empty, to be filled
    in."""
    body = c.assembly.morphology
    motors = np.flatnonzero(body.active)
    longest = lead_lengths(leads)
    rows: list[list[object]] = [
        [
            connection.spring,
            motors[connection.spring],
            connection.face,
            *body.springs[motors[connection.spring]],
            connection.channel,
            "",
            c.spec.coil.current_limit_a,
            longest[connection.spring],
            c.spec.coil.current_conditions,
        ]
        for connection in connections
    ]
    header = ["spring", "spring_in_design", "face", "mass_a", "mass_b", "relay_channel"]
    header += ["resistance_ohm_measured", "current_limit_a", "lead_to_top_mm", "current_conditions"]
    return csv_text(header, rows)
