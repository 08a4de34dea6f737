"""The command `eldir rig setup`."""

from __future__ import annotations

import os
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir_hardware.relay.registration import kinds_text

if TYPE_CHECKING:
    from eldir_app.rig_setup.dialogue import Dialogue
    from eldir_app.rig_setup.draft import RigDraft

_Text = str | None


def setup(
    *,
    out: Annotated[Path, typer.Option(help="Rig file to write, or to continue with.")],
    port: Annotated[
        _Text, typer.Option(help="Serial port of the relay board, or find: by unplugging it.")
    ] = None,
    board: Annotated[_Text, typer.Option(help=f"Kind of the relay board: {kinds_text()}.")] = None,
    in_series: Annotated[
        bool | None,
        typer.Option(
            "--in-series/--no-in-series",
            help="Whether the springs of both faces of a motor are in series on one relay channel.",
        ),
    ] = None,
    channels: Annotated[_Text, typer.Option(help="Number of relays on the board.")] = None,
    contact_rating: Annotated[
        _Text, typer.Option(help="Current that one relay contact may carry [A].")
    ] = None,
    voltage: Annotated[_Text, typer.Option(help="Voltage of the heating supply [V].")] = None,
    outputs: Annotated[
        _Text, typer.Option(help="each or shared: one limited output for each channel, or for all.")
    ] = None,
    current_limit: Annotated[
        _Text, typer.Option(help="Current limit of an output of the supply [A], or unknown.")
    ] = None,
    resistance: Annotated[
        _Text, typer.Option(help="Resistance of one spring at room temperature [Ohm], or unknown.")
    ] = None,
    room: Annotated[_Text, typer.Option(help="Temperature of the air around the springs [C].")] = None,
    fan: Annotated[
        _Text,
        typer.Option(
            help="Fan: interlocked (hardware cuts the heating supply when it stops), not-interlocked or none."
        ),
    ] = None,
    fan_channel: Annotated[_Text, typer.Option(help="Relay channel that runs the fan, or none.")] = None,
    cutoff: Annotated[
        _Text, typer.Option(help="Independent cut-off: timer, thermal, contactor or none.")
    ] = None,
    cutoff_value: Annotated[
        _Text,
        typer.Option(
            help="Time of the timer [s], temperature of the thermal switch [C], or channel of the contactor."
        ),
    ] = None,
    camera: Annotated[
        _Text, typer.Option(help="Camera: camera:0, /dev/video0, the address of a stream, or none.")
    ] = None,
    tags: Annotated[
        _Text, typer.Option(help="File with the places of the reference tags, such as tags.json of a packet.")
    ] = None,
    calibrate: Annotated[
        bool | None,
        typer.Option(
            "--calibrate/--no-calibrate",
            help="Calibrate lens and plane of the camera. Without a terminal: no, unless this is given.",
        ),
    ] = None,
    warm: Annotated[
        bool | None,
        typer.Option(
            "--warm/--no-warm",
            help="Warm one spring after the other, and correct the wiring in the file. It needs a terminal.",
        ),
    ] = None,
    design: Annotated[
        Path | None, typer.Option(help="Design of the robot, to say where each spring is.")
    ] = None,
) -> None:
    """Set up a real rig question by question, and write its rig file step by step.

    Each question shows a default, and its answer can be given as an option. After Ctrl-C the same command
    continues: what is in the file is the default then. Nothing heats without a yes.

    Example: eldir rig setup --out rig.yaml
    """
    from eldir_app.rig_setup.dialogue import Dialogue
    from eldir_app.rig_setup.draft import RigDraft
    from eldir_app.rig_setup.questions import Questions, SetupConfig

    dialogue = Dialogue()
    if warm and not dialogue.is_interactive:
        raise typer.BadParameter("a person at a terminal must feel the springs", param_hint="--warm")
    draft = RigDraft(out)
    series = None if in_series is None else "yes" if in_series else "no"
    config = SetupConfig(
        port=port,
        board=board,
        in_series=series,
        channels=channels,
        contact_rating=contact_rating,
        voltage=voltage,
        outputs=outputs,
        current_limit=current_limit,
        resistance=resistance,
        room=room,
        fan=fan,
        fan_channel=fan_channel,
        cutoff=cutoff,
        cutoff_value=cutoff_value,
        camera=camera,
        tags=tags,
    )
    if config.missing and not dialogue.is_interactive:
        problem = "an answer for each is needed, because there is no terminal to ask at"
        raise typer.BadParameter(problem, param_hint=", ".join(config.missing))
    if tags is not None and Path(tags).exists():  # the rig file names files from its own folder
        config = replace(config, tags=os.path.relpath(tags, out.parent))
    questions = Questions(draft, config, dialogue)
    try:
        if draft.is_begun:
            dialogue.say(f"{out} exists: its values are the defaults")
        dialogue.say("Switch the heating supply off, until this program asks for it")
        questions.ask_board()
        questions.ask_values()
        questions.ask_camera()
        _calibrate(draft, dialogue, calibrate)
        _finish(draft, dialogue, warm, design)
    except (KeyboardInterrupt, typer.Abort) as error:
        if draft.is_begun:
            command = shlex.join(["eldir", "rig", "setup", "--out", str(out)])
            error.add_note(f"the answers so far are in {out}; continue: {command}")
        raise


def _calibrate(draft: RigDraft, dialogue: Dialogue, wanted: bool | None) -> None:
    """Calibrate the lens and the plane of the camera, or say how."""
    from eldir.errors import EldirError
    from eldir_app.commands.calibrate.camera import camera as calibrate_lens
    from eldir_app.commands.calibrate.plane import plane as calibrate_plane
    from eldir_hardware.rig.sections import LiveCameraEntry

    entry, folder = draft.rig.camera, draft.path.parent
    if not isinstance(entry, LiveCameraEntry):
        return
    lens, plane = folder / "camera.json", folder / "plane.json"
    tags, check = folder / (entry.tags or "tags.json"), folder / "plane.png"

    def run_lens() -> None:
        calibrate_lens(entry.device, out=lens)
        draft.set_entries("camera", {"lens": lens.name})

    def run_plane() -> None:
        known = lens if lens.exists() else None
        calibrate_plane(entry.device, tags=tags, out=plane, camera=known, check=check)
        draft.set_entries("camera", {"plane": plane.name})

    lens_line = ["eldir", "calibrate", "camera", entry.device, "--out", str(lens)]
    plane_line = ["eldir", "calibrate", "plane", entry.device, "--tags", str(tags), "--out", str(plane)]
    for done, run, line, request in (
        (
            entry.lens,
            run_lens,
            lens_line,
            "Move the printed calibration sheet before the camera for 30 s "
            "(print it with: eldir calibrate camera --sheet sheet.pdf). Calibrate the lens now?",
        ),
        (
            entry.plane,
            run_plane,
            [*plane_line, "--camera", str(lens), "--check", str(check)],
            "Let the camera see the reference tags, with nothing before them. Calibrate the plane now?",
        ),
    ):
        if done is not None and wanted is None:
            continue
        if wanted or (wanted is None and dialogue.is_interactive and dialogue.confirm(request)):
            try:
                run()
                continue
            except EldirError as error:
                dialogue.say(f"not calibrated: {error}")
        key = f"lens: {lens.name}" if run is run_lens else f"plane: {plane.name}"
        dialogue.say(f"Later: {shlex.join(line)}; then enter {key} at camera in {draft.path}")


def _finish(draft: RigDraft, dialogue: Dialogue, warm: bool | None, design: Path | None) -> None:
    """Check the rig, show its wiring if the person wants it, and say which command is next."""
    from eldir_app.doctor import examine

    rig_file = draft.path
    failed = 0
    for finding in examine(draft.rig, rig_file.parent):
        failed += not finding.ok
        typer.echo(f"{'ok  ' if finding.ok else 'FAIL'}  {finding.subject}: {finding.text}")
    rig = shlex.join(["--rig", str(rig_file)])
    if failed:
        typer.echo(f"wrote {rig_file}; nothing heats before what failed is corrected")
        typer.echo(f"next: correct it, then eldir rig doctor {rig}")
        raise typer.Exit(1)
    felt = _show_wiring(draft, dialogue, warm, design)
    typer.echo(f"wrote {rig_file}")
    if felt:
        named = "design.json" if design is None else shlex.quote(str(design))
        typer.echo(f"next: eldir gait {named} {rig} --out schedule.json")
    else:
        typer.echo(f"next: see whether the right springs grow warm: eldir rig doctor {rig} --wiring")


def _show_wiring(draft: RigDraft, dialogue: Dialogue, warm: bool | None, design: Path | None) -> bool:
    """Warm one spring after the other, and write the wiring that was felt; whether all was felt."""
    from eldir_app.rig_setup.felt_springs import FeltSprings
    from eldir_app.switching_checks import show_wiring

    if warm is False or not dialogue.is_interactive:
        return False
    if warm:
        dialogue.wait_for_enter("One spring after the other is warmed now. Switch the heating supply on")
    elif not dialogue.confirm(
        "Warm one spring after the other, to feel the wiring? If yes, switch the heating supply on first"
    ):
        return False
    springs = FeltSprings(draft.rig, dialogue)
    show_wiring(draft.rig, draft.path, design, dialogue.say, springs.is_answered)
    found = springs.find_wiring()
    if set(found) == set(draft.rig.channels):
        dialogue.say("The springs are wired as the rig file says")
    else:
        draft.set_channels(found)
        dialogue.say(f"Corrected channels in {draft.path}: what you felt differs from the rig file")
    return True
