"""A printer with its resin and process, as a data file, and parts that fit it [mm]."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from eldir.core.arguments import require_known
from eldir.core.validation import Section, validate
from eldir.errors import InputError
from eldir_cad.kit import PRINTER
from eldir_cad.kit.specification import Gap, Length, Specification, kit_file, load_section


class Minimum(Section):
    """The finest features that a printer can print."""

    wall: Length
    """Thinnest wall [mm]."""
    gap: Length
    """Narrowest slot or engraved line [mm]."""
    hole: Length
    """Diameter of the smallest hole [mm]."""
    pin: Length
    """Width of the thinnest pin [mm]."""
    clearance: Gap
    """Smallest clearance between parts that fit into each other [mm]."""


class Material(Section):
    """Resin, cured."""

    name: str
    """Name of the resin."""
    density: Annotated[float, Field(gt=0.1, lt=20)]
    """Density of the cured resin [g/cm3]."""
    tensile_modulus: Annotated[float, Field(gt=0)]
    """Young's modulus in tension [MPa]."""
    flexural_modulus: Annotated[float, Field(gt=0)]
    """Young's modulus in bending [MPa]."""
    flexural_strength: Annotated[float, Field(gt=0)]
    """Flexural strength [MPa]; divided by the flexural modulus it is the strain limit."""

    @property
    def strain_limit(self) -> float:
        """Surface strain at flexural strength."""
        return self.flexural_strength / self.flexural_modulus


class Wash(Section):
    """Washing after printing."""

    solvent: str
    """Solvent of the first wash."""
    on_plate_min: Length
    """Duration of the wash on the plate [min]."""
    rinse: str
    """Liquid of the second wash."""
    off_plate_min: Length
    """Duration of the wash without the plate [min]."""


class Printer(Section):
    """A printer with its resin and process."""

    format: Literal["eldir-printer/1"]
    """Format of this file."""
    name: str
    """Name of the printer, as manifest and traveller state it."""
    volume: tuple[Length, Length, Length]
    """Width, depth and height of the build volume [mm]."""
    pixel: Length
    """Edge of a pixel on the plate [mm]; for the reader, nothing is computed from it."""
    layer: Length
    """Thickness of a layer [mm]; overhangs and islands are searched layer by layer."""
    layer_s: Annotated[float, Field(gt=0, le=600)] | None = None
    """Time of a layer [s]: that of a print, divided by its layers. With it kit.pdf gives the printing time.
    Default: not known."""
    extra_resin: Annotated[float, Field(ge=0, le=10)] | None = None
    """Resin of supports, and of what stays in the vat and on the parts, as a share of the parts' volume.
    With it kit.pdf gives the resin to have ready. Default: not known."""
    margin: Gap
    """Width of the edge of the plate that stays free [mm]."""
    spacing: Gap
    """Least distance between parts on the plate [mm]."""
    allowance: Annotated[float, Field(ge=-0.5, le=0.5)]
    """Added to every clearance, and twice to peg holes and depths of sockets [mm]; found with `eldir
    coupon`."""
    minimum: Minimum
    """The finest features that the printer can print."""
    material: Material
    """The resin, cured."""
    wash: Wash
    """Washing after printing, for the traveller."""
    cure_min: Length
    """Duration of the post-cure [min], for the traveller."""


def printers() -> list[str]:
    """Names of the profiles that come with the kit."""
    return sorted(p.stem for p in kit_file("parts.yaml").parent.glob("*.yaml") if p.stem != "parts")


def load_printer(name: str = PRINTER) -> Printer:
    """Read a printer by the name of its profile, or by the path of a YAML file."""
    profile = Path(name)
    if profile.suffix not in (".yaml", ".yml"):
        profile = kit_file(f"{name}.yaml")
        require_known("printer", name, printers(), "give the path of a .yaml file for another one")
    return load_section(profile, Printer)


def fit_to_printer(specification: Specification, printer: Printer) -> Specification:
    """Add the printer's allowance to the clearance, the sockets and the peg holes. Raises `InputError` for
    dimensions that the printer cannot print."""
    clearance = specification.clearance + printer.allowance
    minimum = printer.minimum
    m, s, c, h = specification.mass, specification.strip, specification.connector, specification.holder
    pocket = s.bulb_diameter / 2 + clearance
    features = (
        ("clearance", clearance, minimum.clearance),
        ("strip.thickness", s.thickness, minimum.wall),
        ("connector.peg", c.peg, minimum.pin),
        ("fitting.wire_guide", specification.fitting.wire_guide, minimum.hole),
        ("the holder's sleeve", (h.across_flats - m.across_flats) / 2 - clearance, minimum.wall),
        ("mass.stroke", m.stroke, minimum.gap),
        ("the rim of mass.disc_diameter", (m.across_flats - m.disc_diameter) / 2, minimum.wall),
        ("mass.floor under seat and engraving", m.floor - m.disc_depth - m.engraving_depth, minimum.wall),
        (
            "wall between two sockets",
            specification.bulb_radius_at - 2 * pocket,
            minimum.wall,
        ),  # 60 degrees apart
        (
            "wall between socket and peg hole",
            specification.bulb_radius_at - pocket - m.peg_hole / 2,
            minimum.wall,
        ),
    )
    for name, size, required in features:
        if size < required - 1e-9:
            raise InputError(
                f"{name} is below the minimum of {printer.name}",
                code="part.too-fine",
                expected=f"at least {required:g} mm",
                found=f"{size:.3g} mm",
                remedy="change the specification or choose another printer",
            )
    values = specification.model_dump() | {"clearance": clearance}
    # Peg hole and depth of the sockets grow with the printer's allowance as the sockets do.
    values["mass"]["socket_depth"] = m.socket_depth + 2 * printer.allowance
    values["mass"]["peg_hole"] = m.peg_hole + 2 * printer.allowance
    return validate(Specification, values, f"the parts for {printer.name}")
