"""A printer with its resin and process, as a data file [mm]."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from cad.kit.data_files import Gap, Length, load, own_data
from cad.kit.defaults import PRINTER
from eldir.core.yaml_files import Section
from eldir.errors import InputError


class Minimum(Section):
    """The finest features that a printer can print."""

    wall: Length
    gap: Length
    """Width of slots and engraving."""
    hole: Length
    pin: Length
    clearance: Gap


class Material(Section):
    """Resin, cured."""

    name: str
    density: Annotated[float, Field(gt=0.1, lt=20)]
    tensile_modulus: Annotated[float, Field(gt=0)]
    flexural_modulus: Annotated[float, Field(gt=0)]
    flexural_strength: Annotated[float, Field(gt=0)]

    @property
    def strain_limit(self) -> float:
        """Surface strain at flexural strength."""
        return self.flexural_strength / self.flexural_modulus


class Wash(Section):
    """Washing after printing."""

    solvent: str
    on_plate_min: Length
    rinse: str
    off_plate_min: Length


class Printer(Section):
    """A printer with its resin and process."""

    format: Literal["eldir-printer/1"]
    name: str
    volume: tuple[Length, Length, Length]
    pixel: Length
    layer: Length
    margin: Gap
    spacing: Gap
    allowance: Annotated[float, Field(ge=-0.5, le=0.5)]
    minimum: Minimum
    material: Material
    wash: Wash
    cure_min: Length


def printers() -> list[str]:
    """Names of the profiles that come with the kit."""
    return sorted(p.stem for p in own_data("parts.yaml").parent.glob("*.yaml") if p.stem != "parts")


def load_printer(name: str = PRINTER) -> Printer:
    """Read a printer by the name of its profile, or by the path of a YAML file."""
    profile = Path(name)
    if profile.suffix not in (".yaml", ".yml"):
        profile = own_data(f"{name}.yaml")
        if name not in (known := printers()):
            raise InputError(
                "unknown printer", expected=" | ".join([*known, "a .yaml file"]), found=repr(name)
            )
    return load(profile, Printer)
