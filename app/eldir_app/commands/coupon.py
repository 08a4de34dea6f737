"""The command `eldir coupon`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eldir_app.options import PartsFile, Printer, check_printer
from eldir_cad.kit import PRINTER


def coupon(
    out: Annotated[Path, typer.Option(help="New folder for the coupon.")],
    printer: Printer = PRINTER,
    parts: PartsFile = None,
) -> None:
    """Write a fit coupon: a test print that gives the fit allowance of your printer.

    Example: eldir coupon --out coupon
    """
    from eldir.core.files import require_new
    from eldir_cad.kit.printer import load_printer
    from eldir_cad.kit.specification import load_specification
    from eldir_cad.packet.coupon import ALLOWANCE, write_coupon

    require_new(out)
    check_printer(printer)
    profile = load_printer(printer)
    write_coupon(out, load_specification(parts), profile)
    print(
        f"{out}: print the plate, and find the numbered socket in which a passive spring can be inserted "
        f"by hand and rotates without play; then write its `{ALLOWANCE}` from coupon.csv as "
        f"`allowance` into the profile of {profile.name}"
    )
