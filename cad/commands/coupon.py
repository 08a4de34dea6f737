"""The command `eldir coupon`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def coupon(
    out: Annotated[Path, typer.Option(help="Folder to write; must not exist yet.")],
    printer: Annotated[str, typer.Option(help="Printer profile: a name, or a YAML file.")] = "xip",
    parts: Annotated[Path | None, typer.Option(help="Specification of the parts, a YAML file.")] = None,
) -> None:
    """Write a fit coupon: print it once to find the allowance of your printer.

    Example: eldir coupon --out coupon
    """
    from cad.commands.packet import check_printer
    from cad.kit.printer import load_printer
    from cad.kit.specification import load_specification
    from cad.packet.coupon import write_coupon

    check_printer(printer)
    profile = load_printer(printer)
    write_coupon(out, load_specification(parts), profile)
    print(
        f"{out}: print the plate; the socket that a passive spring goes into by hand and turns in without "
        f"play has a number; coupon.csv says which `allowance` it means for the profile of {profile.name}"
    )
