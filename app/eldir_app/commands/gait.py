"""The command `eldir gait`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir_app.options import (
    DesignFile,
    SceneFile,
    ScheduleOutput,
    ScheduleRigFile,
    load_design_for_prediction,
)

if TYPE_CHECKING:
    from eldir.built.gait import Gait
    from eldir.design import Design
    from eldir_hardware.planning.plan import PlanConfig
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.safety.compatibility import PacketWiring
    from eldir_hardware.schedule import ActuationSchedule


def gait(
    design: DesignFile,
    rig: ScheduleRigFile,
    out: ScheduleOutput,
    imitate: Annotated[
        bool,
        typer.Option(
            "--imitate", help="Use the phases of the controller, as in the paper. Default: search phases."
        ),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(help="Also draw one predicted cycle into this file, PNG.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the samples.")] = 0,
    scene: SceneFile = None,
    other_than: Annotated[
        list[Path] | None,
        typer.Option(
            help="Log (MCAP) of a run whose gait the new one must differ from, for a film that tells more of "
            "the robot. May be repeated."
        ),
    ] = None,
) -> None:
    """Write a heating schedule for a design on a rig, and predict how far the robot walks.

    By default the command simulates the printed robot and searches phases, period and duty of its motors.
    With --imitate it copies the phases of the controller; with them, robots go forward only by chance. With
    --scene the search uses the identified robot. A filmed gait that walked is then kept, unless another gait
    is better by more than the uncertainty of its prediction.

    Example: eldir gait design.json --rig rig.yaml --out schedule.json
    """
    from eldir.built.scene import PrintedScene
    from eldir.core.files import require_ending, require_new, write_bytes
    from eldir_hardware.planning.plan import PlanConfig, draw_heat
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.safety.compatibility import packet_wiring

    require_ending("--picture", picture, ".png")
    require_new(out, picture)
    robot, loaded = load_design_for_prediction(design), Rig.load(rig)
    identified = None if scene is None else PrintedScene.load(scene)
    design_file = os.path.relpath(design, out.parent)
    if other_than and imitate:
        raise typer.BadParameter("expected one of --imitate and --other-than", param_hint="--other-than")
    others = tuple(_read_gait(log) for log in other_than or ())
    config = PlanConfig(imitate, seed, design_file=design_file, scene=identified, other_than=others)
    schedule = _plan(robot, loaded, config)
    schedule.save(out)
    if picture is not None:
        write_bytes(picture, draw_heat(schedule))
    for line in _prediction_lines(schedule, loaded):
        typer.echo(line)
    if identified is not None and not identified.model_fits:
        typer.echo(
            f"note: it is not certain that the model in {scene} fits the films, so its values are unreliable"
        )
    for warning in _warnings(schedule, loaded):
        typer.echo(f"warning: {warning}", err=True)
    for line in _rig_lines(schedule, loaded, packet_wiring(design, robot.morphology.motors, loaded)):
        typer.echo(line)
    typer.echo(
        f"wrote {out}: {schedule.cycles} cycles of {schedule.period_s:g} s, "
        f"springs at most {schedule.predicted.peak_c:.0f} C"
    )


def _read_gait(log: Path) -> Gait:
    """The gait of a run. Raises `InputError` for a log without one."""
    from eldir.errors import InputError
    from eldir_hardware.log.reader import read_attachment, read_log
    from eldir_hardware.planning.compiler import extract_gait
    from eldir_hardware.schedule import ActuationSchedule

    attached = read_log(log).attachments
    schedule = read_attachment(attached, log, "schedule.json", ActuationSchedule.from_json)
    gait = None if schedule is None else extract_gait(schedule)
    if gait is None:
        raise InputError(
            f"{log} has no gait",
            code="log.no-gait",
            expected="a schedule with one pulse of each spring in a period, alike on both faces",
        )
    return gait


def _plan(design: Design, rig: Rig, config: PlanConfig) -> ActuationSchedule:
    """Plan the schedule with a progress bar."""
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    from eldir_app.progress import progress_bar
    from eldir_hardware.planning.plan import plan

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    note = "planning: about a minute, or several where springs cool slowly"
    with progress_bar(*columns, note=note) as progress:
        task = progress.add_task("reading", total=None)
        return plan(
            design,
            rig,
            config,
            lambda stage: progress.update(task, description=stage),
        )


def _prediction_lines(schedule: ActuationSchedule, rig: Rig) -> Iterator[str]:
    """The predicted walk of each method, how much it depends on heat, and why the gait was chosen."""
    from eldir.built.walking import describe_ties
    from eldir_hardware.planning.plan import describe_walk
    from eldir_hardware.planning.tolerance_walks import describe_tolerances

    predicted = schedule.predicted
    for method, walk in predicted.displacement.items():
        chosen = "*" if method == predicted.method else " "
        yield f"{chosen} {method}: {'; '.join(describe_walk(walk))}"
    if predicted.walk is not None and predicted.walk.tie_share is not None:
        yield describe_ties(predicted.walk.tie_share)
    if predicted.tolerances is not None:
        yield describe_tolerances(predicted.tolerances, rig)
    if predicted.choice is not None:
        yield predicted.choice


def _warnings(schedule: ActuationSchedule, rig: Rig) -> Iterator[str]:
    """Implausible springs, and thermal switches that open in every cycle."""
    from eldir_hardware.rig.supply import find_implausible_springs
    from eldir_hardware.safety.worst_heat import describe_early_cutoff

    yield from find_implausible_springs(rig).values()
    cycle = schedule.predicted.cycle
    if cycle is not None and (warning := describe_early_cutoff(rig, max(map(max, cycle.temperature_c)))):
        yield warning


def _rig_lines(schedule: ActuationSchedule, rig: Rig, packet: PacketWiring) -> Iterator[str]:
    """Notes on the wiring and the timing, and the margins to the limits of the rig."""
    from eldir_hardware.planning.compiler import describe_precision
    from eldir_hardware.planning.tolerance_walks import describe_narrower
    from eldir_hardware.safety.compatibility import compare_wiring
    from eldir_hardware.safety.margins import describe_margins

    if note := compare_wiring(rig, packet):
        yield f"note: not wired as {packet.source} says: {note}"
    if note := describe_precision(schedule, rig):
        yield f"note: {note}"
    if schedule.predicted.margins is not None:
        yield describe_margins(schedule.predicted.margins, rig)
    yield from describe_narrower(schedule.predicted.narrower or (), rig)
