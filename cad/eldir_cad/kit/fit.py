"""Fitting a specification to a printer [mm]."""

from __future__ import annotations

from eldir.core.validation import validated
from eldir.errors import InputError
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification


def fitted_to_printer(specification: Specification, printer: Printer) -> Specification:
    """The specification with the printer's allowance in its clearance, sockets and peg holes. Raises
    `InputError` for dimensions that the printer cannot print."""
    clearance = specification.clearance + printer.allowance
    least = printer.minimum
    m, s, c, h = specification.mass, specification.strip, specification.connector, specification.holder
    pocket = s.bulb_diameter / 2 + clearance
    features = (
        ("clearance", clearance, least.clearance),
        ("strip.thickness", s.thickness, least.wall),
        ("connector.peg", c.peg, least.pin),
        ("fitting.wire_guide", specification.fitting.wire_guide, least.hole),
        ("the holder's sleeve", (h.across_flats - m.across_flats) / 2 - clearance, least.wall),
        ("mass.stroke", m.stroke, least.gap),
        ("the rim of mass.disc_diameter", (m.across_flats - m.disc_diameter) / 2, least.wall),
        ("mass.floor under seat and engraving", m.floor - m.disc_depth - m.engraving_depth, least.wall),
        (
            "wall between two sockets",
            specification.bulb_radius_at - 2 * pocket,
            least.wall,
        ),  # 60 degrees apart
        (
            "wall between socket and peg hole",
            specification.bulb_radius_at - pocket - m.peg_hole / 2,
            least.wall,
        ),
    )
    for name, found, needed in features:
        if found < needed - 1e-9:
            raise InputError(
                f"{name} is below what {printer.name} prints",
                code="part.too-fine",
                expected=f"at least {needed:g} mm",
                found=f"{found:.3g} mm",
                remedy="change the specification or choose another printer",
            )
    values = specification.model_dump() | {"clearance": clearance}
    # Peg hole and depth of the sockets grow with the printer's allowance as the sockets do.
    values["mass"]["socket_depth"] = m.socket_depth + 2 * printer.allowance
    values["mass"]["peg_hole"] = m.peg_hole + 2 * printer.allowance
    return validated(Specification, values, f"the parts for {printer.name}")
