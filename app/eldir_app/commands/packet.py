"""The command `eldir packet`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eldir_app.options import DesignFile, InSeries, PartsFile, Printer, check_printer
from eldir_cad.kit import PRINTER


def packet(
    design: DesignFile,
    out: Annotated[Path, typer.Option(help="New folder for the packet.")],
    printer: Printer = PRINTER,
    parts: PartsFile = None,
    without_motor: Annotated[
        int | None,
        typer.Option(help="Replace the motor with this number, from 0, by a passive spring.", min=0),
    ] = None,
    ballast: Annotated[
        str | None, typer.Option(help="Add a weight, such as 9g@front, 5g@rear or 4g@12 (a mass).")
    ] = None,
    in_series: InSeries = False,
    prices: Annotated[
        Path | None,
        typer.Option(help="YAML file with your prices: bom.csv and kit.pdf then have the cost."),
    ] = None,
    marker: Annotated[
        str, typer.Option(help="Kind of the markers on m1 to m5: discs, aruco, apriltag.")
    ] = "discs",
    as_json: Annotated[bool, typer.Option("--json", help="Print the manifest as JSON.")] = False,
) -> None:
    """Write the build packet of a design: parts, plates, lists, wiring, process sheet, assembly map, markers.

    Example: eldir packet design.json --out packet --without-motor 0 --ballast 9g@front
    """
    from eldir.core.files import require_new

    require_new(out)
    from rich.console import Console

    from eldir.design import Ballast, Design, Variant
    from eldir.errors import InputError
    from eldir_cad.kit.prices import load_prices
    from eldir_cad.kit.printer import load_printer
    from eldir_cad.kit.specification import load_specification
    from eldir_cad.packet.folder import apply_variant, write_packet
    from eldir_hardware.markers.placement import placement_files
    from eldir_hardware.markers.registration import require_kind

    robot = Design.load(design)
    check_printer(printer)
    try:
        mass = None if ballast is None else Ballast.parse(ballast, robot.morphology)
    except InputError as error:
        raise typer.BadParameter(str(error), param_hint="--ballast") from None
    built, specification = apply_variant(robot, Variant(without_motor, mass)), load_specification(parts)
    price_list = None if prices is None else load_prices(prices)
    require_kind(marker)
    console = Console(stderr=True)
    with console.status("computing parts and plates"):
        sheets = placement_files(built, 1e-3 * specification.scale, marker)
        printing = load_printer(printer)
        written = write_packet(
            built,
            out,
            specification,
            printing,
            in_series=in_series,
            prices=price_list,
            more_files=sheets,
        )
    for violation in written.report.violations:
        console.print(f"{violation.severity}: {violation}", markup=False, highlight=False, soft_wrap=True)
    totals = written.manifest.totals
    if as_json:
        print((out / "manifest.json").read_text(), end="")
    else:
        print(f"{out}: {totals.parts} parts on {totals.plates} plates, {totals.weight_g:.1f} g of resin")
        if (ground := written.manifest.ground) is not None:
            weight = sum(piece.weight_g for piece in ground.values())
            print(f"ground: {len(ground)} pieces, {weight:.0f} g of resin; assembly.pdf says how they lie")
        if written.cost is not None:
            print(f"cost: {written.cost}")
