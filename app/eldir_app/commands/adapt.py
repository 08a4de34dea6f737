"""The command `eldir adapt`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir_app.options import DesignFile, RigFile, load_design_for_prediction

if TYPE_CHECKING:
    from eldir_calibration.adaptation.runs import Adaptation, AdaptationRun, SupplyAdvice
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.schedule import ActuationSchedule


def adapt(
    design: DesignFile,
    rig_file: RigFile,
    out: Annotated[
        Path, typer.Option(help="Folder for schedules, logs and beliefs; an adaptation in it goes on.")
    ],
    runs: Annotated[int, typer.Option(min=1, max=30, help="Number of runs at most.")] = 5,
    minutes: Annotated[
        float | None,
        typer.Option(min=0, help="No run begins that would end later than this after the start [min]."),
    ] = None,
    prior: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder of an adaptation of another robot of the same kit; may be given several times."
        ),
    ] = None,
    room: Annotated[
        float | None, typer.Option(help="Temperature of the air around the springs during all runs [C].")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of beliefs and samples.")] = 0,
    unattended: Annotated[
        bool, typer.Option("--unattended", help="Heat a real rig without asking before each run.")
    ] = False,
) -> None:
    """Find the gait with which this robot walks farthest on this table.

    Each run plays a schedule, films the robot and finds the robots that may be the filmed one; the next gait
    is the one that is expected to walk farthest. It ends when no other gait is worth a run. The same command
    continues an adaptation that was interrupted. All limits of the rig file hold in every run.

    Example: eldir adapt design.json --rig rig.yaml --out adapted
    """
    from eldir_app.progress import progress_bar
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.safety.latch import require_unlatched
    from eldir_hardware.safety.limits import check_rig, check_room

    _require_own_folder(out)
    load_design_for_prediction(design)
    rig = Rig.load(rig_file)
    check_rig(rig)
    check_room(rig, room)
    if rig.kind == "real" and rig.board.port is not None:
        require_unlatched(rig.board.port)
    _require_camera(rig)

    from eldir.built.walking import describe_doubt
    from eldir_app.commands.rig.drive import play, print_notes
    from eldir_calibration.adaptation.loop import adapt
    from eldir_calibration.adaptation.runs import AdaptationConfig
    from eldir_hardware.run.drive import DriveConfig

    with progress_bar(note="each run takes as long as its schedule, and the computer a minute or two") as bar:
        task = bar.add_task("reading", total=None)

        def ask(number: int, schedule: ActuationSchedule) -> None:
            bar.stop()
            print_notes(schedule, rig, rig_file, design)
            walk = schedule.predicted.walk
            if walk is not None and (doubt := describe_doubt(walk.tie_share)):
                typer.echo(f"run {number}: {doubt}")
            if rig.kind == "real" and not unattended:
                _ask(number, schedule)
            bar.start()

        def drive(schedule: ActuationSchedule, log: Path) -> None:
            bar.stop()
            play(schedule, rig, rig_file, log, DriveConfig(design, room_c=room))
            bar.start()

        def show(what: str, part: float) -> None:
            bar.update(task, description=what)

        def print_run(number: int, run: AdaptationRun) -> None:
            typer.echo(_describe(number, run))

        config = AdaptationConfig(runs=runs, minutes=minutes, seed=seed)
        found = adapt(
            design, rig, out, drive, config, show, print_run, ask=ask, prior=prior or (), room_c=room
        )
    typer.echo(f"ended: {found.ended}")
    if not found.runs:
        return
    typer.echo(_describe_heat(found, rig))
    for fault in found.faults:
        typer.echo(f"run {fault.run}: {fault.text}; {fault.remedy}")
    typer.echo(f"wrote {out / 'adaptation.html'}")
    if found.best is None:
        typer.echo(
            f"no schedule is written: every run with {rig.supply.current_limit_a:g} A ended with a fall or "
            "with springs above their limit, or there is none"
        )
        return
    best = found.runs[found.best - 1]
    for advice in found.advice:
        typer.echo(_describe_advice(advice, rig, best.filmed))
    typer.echo(f"wrote {out / 'schedule.json'}: that of {_describe_best(found.best, best)}")


def _require_own_folder(out: Path) -> None:
    """Raise `EldirError` for a folder that holds something other than an adaptation, or cannot be written."""
    from eldir.core.files import require_folder
    from eldir.errors import EldirError
    from eldir_calibration.adaptation.prior import PRIOR

    require_folder(out / PRIOR)
    names = {path.name for path in out.iterdir()} if out.is_dir() else set()
    # A program that was killed leaves the temporary name under which it wrote.
    names = {name for name in names if not name.startswith(f".{PRIOR}.")}
    is_own = "run_01" in names or names <= {PRIOR}
    if out.exists() and not (out.is_dir() and is_own):
        raise EldirError(
            f"{out} is no folder of an adaptation",
            code="adapt.other-folder",
            expected="a new folder, or one of eldir adapt",
            remedy="give another --out",
        )


def _require_camera(rig: Rig) -> None:
    """Raise `InputError` for a rig that films nothing, before it heats."""
    from eldir.errors import InputError

    if rig.camera is None:
        raise InputError(
            "the rig file has no camera",
            code="adapt.no-camera",
            expected="camera, with which each run is filmed",
            remedy="eldir rig setup writes the entry",
        )


def _ask(number: int, schedule: ActuationSchedule) -> None:
    """Wait until a person has put the robot back."""
    typer.confirm(
        f"run {number}: {schedule.duration:.0f} s of heating and rest. "
        "Put the robot at its start, in sight of the camera. Heat now?",
        abort=True,
    )


def _describe(number: int, run: AdaptationRun) -> str:
    """One line about a run."""
    before = (
        "a fall"
        if run.predicted is None
        else f"{run.predicted:+.2f} (standard deviation {run.deviation:.2f})"
    )
    filmed = "a fall" if run.has_fallen else f"{run.filmed:+.2f}"
    line = f"run {number}: predicted {before}, filmed {filmed} body lengths per five cycles"
    if run.cycles is not None and not run.has_fallen:
        line += f", over {run.cycles} cycles"
    line += _describe_end(run)
    if run.misfit is not None and run.misfit > 1.0:
        line += "; in the films before, the robot moved as no simulated one does"
    if run.impossible_motion is not None:
        line += f"; not possible in reality: {run.impossible_motion}"
    return line


def _describe_end(run: AdaptationRun) -> str:
    """How the film of a run ended whose robot was lost; empty for others."""
    from eldir.built.gait import describe_loss

    return "" if run.lost_at_s is None else f", {describe_loss(run.lost_at_s)}"


def _describe_best(number: int, run: AdaptationRun) -> str:
    """The run whose schedule is kept."""
    remark = "" if run.impossible_motion is None else ", which is not possible in reality"
    return f"run {number}, filmed {run.filmed:+.2f}{_describe_end(run)}{remark}"


def _describe_heat(found: Adaptation, rig: Rig) -> str:
    """One line about the springs in the last run, or why nothing is known of them."""
    heat = found.heat
    if heat is None and found.stands_still:
        return "the robot hardly moves, so the film does not tell how hot its springs get"
    if heat is None:
        return (
            "the robot moves as no simulated one does: the films do not tell how hot its springs get, nor "
            "what another current would bring; look for a marker that was lost or a part that rubs"
        )
    low, high = heat.peak_interval
    return (
        f"the springs reach {heat.peak_c:.0f} C ({low:.0f} to {high:.0f}; limit "
        f"{rig.limits.max_temperature_c:g} C) and use {heat.stroke_used:.0%} of their stroke"
    )


def _describe_advice(advice: SupplyAdvice, rig: Rig, filmed: float) -> str:
    """One line about a higher current."""
    from eldir_hardware.planning.tolerance_walks import describe_measured

    measured = describe_measured(advice.current, (advice.ambient_min_c, advice.ambient_max_c), rig)
    if advice.predicted is None:
        walk = "predicted to fall"
    else:
        walk = f"predicted {advice.predicted:+.2f} (standard deviation {advice.deviation:.2f})"
    return (
        f"with a current limit of {advice.current_limit_a:.2f} A, if {measured}: {walk} "
        f"with the same gait, instead of the filmed {filmed:+.2f}"
    )
