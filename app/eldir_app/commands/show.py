"""The command `eldir show`: a picture or a video of a design."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir_app.options import load_design_for_prediction

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np

    from eldir.design import Design

_FRAME_RATE = 25  # [1/s]
_WEBP_RATE = 10  # [1/s]


def show(
    design: Annotated[
        Path, typer.Argument(metavar="DESIGN", help="Design file, or the folder of a run: its best robot.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Picture (.png), video (.webm) or small moving picture (.webp) to write. Default: "
            "DESIGN.png, with --schedule DESIGN.webm.",
        ),
    ] = None,
    schedule: Annotated[
        Path | None,
        typer.Option(help="Heating schedule: film the predicted walk of the printed robot under it."),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(help="Rig file for which the schedule was made. Default: the one of `eldir rig new`."),
    ] = None,
) -> None:
    """Draw a design (.png), or film its motion (.webm, .webp): the learned one, or the predicted one.

    Without --schedule the film shows what the neural controller learned in the paper's scene. With it, it
    shows the printed robot, ten times as fast. Passive springs are grey, motors are orange-red; a motor turns
    darker when it contracts and lighter when it expands. m1 to m5 are the masses that the camera tracks.

    Example: eldir show design.json --schedule schedule.json --out walk.webm
    """
    suffixes = (".webm", ".webp") if schedule is not None else (".png", ".webm", ".webp")
    if out is not None and out.suffix not in suffixes:
        raise typer.BadParameter(f"--out: expected a name that ends in {', '.join(suffixes)}, found {out}")
    if rig is not None and schedule is None:
        raise typer.BadParameter("--rig needs --schedule")
    from eldir.core.files import require_folder, write_bytes
    from eldir.design import Design
    from eldir.show import picture

    target = out if out is not None else _beside(design, ".png" if schedule is None else ".webm")
    require_folder(target)
    read = Design.load if schedule is None else load_design_for_prediction
    robot = _best(design) if design.is_dir() else read(design)
    if target.suffix == ".png":
        write_bytes(target, picture(robot))
    else:
        rate = _FRAME_RATE if target.suffix == ".webm" else _WEBP_RATE
        film = _learned(robot, rate) if schedule is None else _predicted(robot, schedule, rig, rate)
        _write_film(target, *film, rate)
    print(target)


def _beside(design: Path, suffix: str) -> Path:
    """The file beside a design or a folder that has its name."""
    if design.is_dir():
        folder = design.absolute().resolve()
        return folder.with_name(folder.name + suffix)
    return design.with_suffix(suffix)


def _best(run: Path) -> Design:
    """The best robot of the last complete generation of a run. Raises `InputError` if there is none."""
    from eldir.errors import InputError
    from eldir.evolution.designs import load_run

    designs = load_run(run, count=1)
    if not designs:
        raise InputError(f"{run} has no robot yet", code="show.no-robot", remedy="wait for a generation")
    return designs[0]


def _learned(robot: Design, rate: int) -> tuple[Iterator[np.ndarray], int]:
    """Frames of the learned motion, and their number."""
    from eldir.rollout import simulate_one
    from eldir.show import frames

    rollout = simulate_one(robot.morphology, robot.controller, robot.scene)
    return frames(robot, rollout, rate), int(robot.scene.steps * robot.scene.dt * rate) + 1


def _predicted(
    robot: Design, schedule_file: Path, rig_file: Path | None, rate: int
) -> tuple[Iterator[np.ndarray], int]:
    """Frames of the predicted motion, and their number. Raises `InputError` for a schedule of another design
    or rig."""
    from eldir.built.robot import build
    from eldir.core.yaml_files import parse_yaml
    from eldir.show import PRINTED_SPEED, printed_frames
    from eldir_calibration.comparison.predictions import predict_body
    from eldir_calibration.comparison.recorded_run import RecordedRun
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.rig.template import virtual_rig
    from eldir_hardware.safety.compatibility import require_same_rig
    from eldir_hardware.schedule import ActuationSchedule

    heating = ActuationSchedule.load(schedule_file)
    template = "the rig file of eldir rig new"
    rig = (
        Rig.from_json(parse_yaml(virtual_rig(physics="mujoco").encode(), template))  # a robot with hubs
        if rig_file is None
        else Rig.load(rig_file)
    )
    require_same_rig(heating, robot, rig, str(rig_file or template))
    body = predict_body(RecordedRun(robot, heating, rig))
    begin, length = heating.start_of_cycles, build(robot.morphology).body_length
    count = int((body.times[-1] - begin) * rate / PRINTED_SPEED) + 1
    return printed_frames(robot, body.times, body.positions, begin, length, rate), count


def _write_film(target: Path, frames: Iterator[np.ndarray], count: int, rate: int) -> None:
    from eldir_app.progress import progress_bar
    from eldir_hardware.images.video import write_webm, write_webp

    write = write_webm if target.suffix == ".webm" else write_webp
    with progress_bar() as progress:
        write(target, progress.track(frames, total=count, description="drawing"), rate)
