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
    of_resin = None if prices is None else prices.resin_kg
    rows: list[list[object]] = []
    costs: list[float | None] = []

    def add_printed(name: str, purpose: str, count: int, volume: float, *where: object) -> None:
        weight = volume * density
        rows.append([name, purpose, count, f"{volume:.1f}", f"{weight:.3f}", *where])
        costs.append(None if of_resin is None else 1e-3 * count * weight * of_resin)

    for name, count in c.assembly.counts.items():
        part, supports = c.assembly.parts[name], c.inspections[name].supports
        add_printed(name, part.purpose, count, part.volume, f"{name}.stl", part.pose, supports)
    for piece in () if c.ground is None else c.ground.pieces:
        part = piece.part
        add_printed(part.name, part.purpose, 1, part.volume, f"{part.name}.stl", part.pose, "none")
    if c.printer.extra_resin is not None:
        extra = total_volume(c) * c.printer.extra_resin
        add_printed("extra_resin", "supports; resin in the vat and on parts", 1, extra, "", "", "")
    for item in bought:
        purpose = item.purpose + (f"; count in {item.unit}" if item.unit else "")
        rows.append([item.name, purpose, item.count, "", "", "", "", ""])
        costs.append(None if prices is None else prices.cost_of(item.name, item.count))
    header = ["part", "purpose", "count", "volume_mm3", "weight_g", "file", "printed", "supports"]
    if prices is not None:
        header.append(f"price_{prices.currency}")
        rows = [[*row, "" if cost is None else f"{cost:.2f}"] for row, cost in zip(rows, costs, strict=True)]
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
