"""Options that several commands share, and the checks of their values."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir.core.kernels import DeviceChoice
from eldir.errors import InputError

if TYPE_CHECKING:
    from eldir.design import Design
    from eldir_hardware.rig.configuration import Rig

DesignFile = Annotated[Path, typer.Argument(help="Design file.")]
RigFile = Annotated[Path, typer.Option("--rig", help="The rig file.")]
ScheduleRigFile = Annotated[
    Path, typer.Option("--rig", help="Rig file: springs, supply, limits and channels.")
]
ScheduleOutput = Annotated[Path, typer.Option(help="Schedule file to write, JSON.")]
SceneFile = Annotated[Path | None, typer.Option(help="Identified robot: a file of eldir calibrate dynamics.")]
Printer = Annotated[str, typer.Option(help="Printer profile: its name, or a YAML file.")]
PartsFile = Annotated[Path | None, typer.Option(help="Specification of the parts: a YAML file.")]
InSeries = Annotated[
    bool,
    typer.Option(
        "--in-series",
        help="Wire the springs of both faces of a motor in series on one relay channel: they have the same "
        "current then.",
    ),
]
Device = Annotated[
    DeviceChoice | None,
    typer.Option(
        "--device",
        help="Where robots learn: on the processor, on a GPU by CUDA or Vulkan, or auto: by CUDA where there "
        "is a GPU. Default: ELDIR_DEVICE, or cpu.",
    ),
]


def select_device(device: DeviceChoice | None) -> None:
    """Let robots learn on this device from now on, in this process. None: on that of `ELDIR_DEVICE`."""
    if device is not None:
        os.environ["ELDIR_DEVICE"] = device


def check_printer(name: str) -> None:
    """Raise `typer.BadParameter` unless the text is the name of a printer profile or a YAML file."""
    from eldir_cad.kit.printer import printers

    if Path(name).suffix not in (".yaml", ".yml") and name not in printers():
        known = ", ".join(printers())
        raise typer.BadParameter(f"expected {known} or a .yaml file; found {name!r}", param_hint="--printer")


def load_design_for_prediction(file: Path) -> Design:
    """Read the design of a robot whose motion the command predicts. Warns where its parts are not the kit's:
    predictions know no others."""
    from eldir.design import Design

    design = Design.load(file)
    if design.parts_remark:
        typer.echo(f"warning: {file}: {design.parts_remark}", err=True)
    return design


def load_real_rig(rig_file: Path) -> tuple[Rig, str]:
    """The rig and its serial port. Raises `InputError` for a virtual rig, which has no port."""
    from eldir_hardware.rig.configuration import Rig

    rig = Rig.load(rig_file)
    if rig.kind == "virtual" or rig.board.port is None:
        raise InputError(
            f"{rig_file} is a virtual rig: it has no port and heats nothing",
            code="rig.virtual",
            expected="kind: real",
        )
    return rig, rig.board.port
