"""The command `eldir export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eldir_app.options import DesignFile, PartsFile, Printer, check_printer, load_design_for_prediction
from eldir_cad.kit import PRINTER


def export(
    design: DesignFile,
    out: Annotated[Path, typer.Option(help="Model file to write, MJCF (.xml).")],
    schedule: Annotated[
        Path | None,
        typer.Option(help="Heating schedule: also write its free lengths, and a program that runs both."),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            help="Rig file for which the schedule was made: springs and supply. Default: those of the parts."
        ),
    ] = None,
    dimensions: Annotated[
        int,
        typer.Option(
            min=2,
            max=3,
            help="3: each face has its own strips, springs and feet; the robot may turn and fall sideways.",
        ),
    ] = 2,
    printer: Printer = PRINTER,
    parts: PartsFile = None,
) -> None:
    """Write the nominal robot as a MuJoCo model, with the shapes of its parts in a folder beside it.

    Writing needs no MuJoCo. To look at it: pip install mujoco; python -m mujoco.viewer --mjcf=robot.xml

    Example: eldir export design.json --schedule schedule.json --out robot.xml
    """
    from eldir.core.files import require_new
    from eldir.design import Design
    from eldir_cad.kit.printer import load_printer
    from eldir_cad.kit.specification import load_specification
    from eldir_hardware.planning.model_export import export_robot
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.rig.supply import power_shares, require_measured
    from eldir_hardware.safety.compatibility import require_same_rig
    from eldir_hardware.schedule import ActuationSchedule

    if out.suffix != ".xml":
        raise typer.BadParameter(f"expected a file that ends in .xml; found {out.name!r}", param_hint="--out")
    require_new(out)
    check_printer(printer)
    # With --parts the model has these parts: nothing to warn of.
    robot = Design.load(design) if parts is not None else load_design_for_prediction(design)
    loaded = None if rig is None else Rig.load(rig)
    springs, shares = None, None
    if loaded is not None:
        require_measured(loaded)
        springs = loaded.spring_parameters()
        shares = power_shares(loaded, springs)
    heating = None if schedule is None else ActuationSchedule.load(schedule)
    if heating is not None and loaded is not None:
        require_same_rig(heating, robot, loaded, str(rig))
    kit = load_specification(parts), load_printer(printer)
    written = export_robot(robot, out, *kit, heating, springs, dimensions, shares)
    for path in written:
        typer.echo(f"wrote {path}")
