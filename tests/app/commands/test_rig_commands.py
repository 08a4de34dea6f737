"""`eldir rig`: second pulses measured, dry runs, keys, pauses and steps, the doctor's further checks."""

import os
import pty
import subprocess
import sys
import time
from dataclasses import asdict

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.errors import EldirError
from eldir_app import doctor
from eldir_app.catalogue.facts import read_facts
from eldir_app.catalogue.listing import ending, selected
from eldir_app.catalogue.runs import CataloguedRun
from eldir_app.commands.rig import rig as command
from eldir_app.switching_checks import measure_retriggerable
from eldir_app.watch.run_view import RunView
from eldir_hardware.camera.lens import validity_period
from eldir_hardware.clock import VirtualClock, WallClock
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.log.following import LogFollower
from eldir_hardware.log.reader import is_dry_run, read_log
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_driver, get_emulator
from eldir_hardware.run.player import Player
from eldir_hardware.run.remote_control import obey_keys
from eldir_hardware.safety.latch import LatchedError
from eldir_hardware.safety.stop_signals import StoppedError
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.emulated_rigs import emulated, rig_file, run
from tests.hardware.rigs_and_schedules import gait, rig_text, rig_with
from tests.hardware.virtual.piston_and_observer import Notes, Piston
from tests.raised import raises


@pytest.mark.parametrize("restarts", [True, False])
def test_a_second_pulse_is_measured_and_written_down(restarts, tmp_path):
    board = get_emulator("modbus")(4, WallClock())
    board.retriggerable = restarts
    path = rig_file(tmp_path / "rig.yaml", "modbus", board.start())
    path.write_text("# mine\n" + path.read_text().replace("retriggerable: true", "retriggerable: null"))
    refused = run("doctor", "--rig", path, "--pulses")
    assert refused.exit_code == 2 and board.contact_events == []
    result = run("doctor", "--rig", path, "--pulses", "--heat-disconnected")
    said = "restarts the timer" if restarts else "is ignored"
    assert f"a second pulse {said}" in result.output
    assert Rig.load(path).board.retriggerable is restarts and "# mine" in path.read_text()
    assert not any(board.contacts)
    board.close()


def test_a_board_that_does_neither_is_refused():
    """Its pulses never end, or end too early."""
    clock = VirtualClock()
    emulated = get_emulator("modbus")(2, clock)
    board = get_driver("modbus")(emulated.start(), 2, clock)
    clock.add_barrier(lambda: emulated.wait_for_bytes(board.bytes_written))
    flash = emulated._flash
    emulated._flash = lambda number, on, seconds: flash(number, on, 20.0)
    with raises(EldirError, "doctor.stays-closed"):
        measure_retriggerable(board, clock, 1)
    emulated._flash = lambda number, on, seconds: flash(number, on, 0.3)
    with raises(EldirError, "doctor.wrong-time"):
        measure_retriggerable(board, clock, 1)
    board.close()
    emulated.close()


def test_a_dry_run_switches_nothing(tmp_path):
    board = get_emulator("lcus")(4, WallClock())
    path = rig_file(tmp_path / "rig.yaml", "lcus", board.start())
    compile_schedule(gait(), Rig.load(path), (7, 12), cycles=1).save(tmp_path / "schedule.json")
    log = tmp_path / "dry.mcap"
    result = run("drive", tmp_path / "schedule.json", "--rig", path, "--log", log, "--dry-run")
    assert result.exit_code == 0, result.exception
    assert board.contact_events == [] and board._bytes_received == 0
    assert np.asarray(read_log(log).relays).any()
    board.close()
    assert "a rehearsal on an emulated board" in result.output
    _check_rehearsal(log)


def _check_rehearsal(log):
    """Log, catalogue and page call it so: the rig file in it is that of a real board."""
    content = read_log(log)
    assert content.is_dry_run and "dry_run" in [part for _, part, _ in content.statuses]
    assert is_dry_run({}, content.epoch_ns, content.attachments["rig.yaml"]), "older logs do not say it"
    assert not is_dry_run({}, 10**18, content.attachments["rig.yaml"])
    assert not is_dry_run({}, content.epoch_ns, rig_text().encode()), "a virtual rig's run"
    facts = read_facts(log)
    assert facts.rehearsal and facts.physics == "emulated board"
    run = CataloguedRun(log, 1, **asdict(facts))
    assert ending(run) == "rehearsal: to the end" and selected([run], ["rehearsal"]) == [run]
    with LogFollower(log) as followed:
        view = RunView(log)
        for message in followed.poll():
            view.update(message, followed)
    assert view.plan["rehearsal"]


def test_a_run_that_a_stop_forbids_leaves_no_log(tmp_path):
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        compile_schedule(gait(), Rig.load(path), (7, 12), cycles=1).save(tmp_path / "schedule.json")
        assert run("off", "--rig", path).exit_code == 0
        played = (tmp_path / "schedule.json", "--rig", path, "--log", tmp_path / "log.mcap")
        refused = run("drive", *played).exception
        assert isinstance(refused, LatchedError) and "is stopped: " in str(refused)
        assert not (tmp_path / "log.mcap").exists()
        assert run("drive", *played, "--dry-run").exit_code == 0, "it needs no port"
        assert (tmp_path / "log.mcap").exists()


def play(meddle, cycles: int = 2):
    """A schedule in virtual time, meddled with at times of the schedule."""
    rig, notes = rig_with(), Notes()
    schedule = compile_schedule(gait(), rig, cycles=cycles)
    with VirtualRig(rig, Piston()) as virtual:
        player = Player(
            PulseController(virtual.board, rig, virtual.clock), schedule, rig, virtual.clock, [notes]
        )
        start = virtual.clock.now() + 1.0
        for t, action in meddle(player):
            virtual.clock.call_at(start + t, lambda _, action=action: action())
        try:
            notes.played = player.play(start)
        except EldirError as error:
            notes.error = error
        edges = [(e.t - start, e.channel, e.closed) for e in virtual.emulator.contact_events]
        assert not any(virtual.emulator.contacts)
    return schedule, notes, edges


def test_pause_and_resume():
    """A pause opens at once; the cycle begins again when the next one would have begun."""
    schedule, notes, edges = play(lambda p: [(5.0, p.pause), (8.0, p.resume)])
    first = [e for e in edges if e[1] == 1]
    assert first[0][2] and not first[1][2] and 5.0 <= first[1][0] < 5.4
    assert first[2][0] == pytest.approx(23.0, abs=0.1)
    assert len([e for e in first if e[2]]) == 3 + 1, "both cycles and the conditioning one are whole"
    assert [text.split()[0] for _, text in notes.events] == ["paused", "resumed:"]
    assert notes.played.duration_s > schedule.duration + 3


@pytest.mark.parametrize("into", [0.1, 5.4, 7.0, 15.4, 19.8])
def test_no_pause_ends_in_a_limit(into):
    """Twice: in the second cycle, resumed as soon as it can be, and again in the same place when it is played
    again. A cycle that began 8 s after a pulse of 5.5 s was 2 K too hot for the worst spring."""
    meddle = [
        (23.0 + into, "pause"),
        (23.3 + into, "resume"),
        (43.0 + into, "pause"),
        (49.0 + into, "resume"),
    ]
    schedule, notes, _ = play(lambda p: [(t, getattr(p, name)) for t, name in meddle])
    assert notes.played.ended == "played to the end", notes.error
    assert notes.played.peak_c < schedule.predicted.peak_c + 0.5


def test_a_step_plays_one_cycle():
    _, notes, edges = play(lambda p: [(1.0, p.pause), (2.0, p.step), (60.0, p.finish)])
    assert len([e for e in edges if e[1] == 1 and e[2]]) == 1
    assert [text.split()[0] for _, text in notes.events].count("paused") == 2
    assert notes.played.duration_s < 62, "finished without an error"


def test_a_key_stops_and_others_pause():
    """On a real terminal of its own."""
    host, guest = pty.openpty()
    pressed = []

    class Told:
        paused = False

        def __getattr__(self, name):
            return lambda *why: pressed.append((name, *why))

    with obey_keys(Told(), guest):
        for key in (b" ", b"s", b"q", b"f", b"x"):
            os.write(host, key)
            time.sleep(0.05)
    os.close(host)
    os.close(guest)
    assert pressed == [("pause",), ("step",), ("finish_cycle",), ("stop", "stopped by a key")]
    _, notes, edges = play(lambda p: [(5.0, lambda: p.stop("stopped by a key"))])
    assert isinstance(notes.error, StoppedError) and max(t for t, _, _ in edges) < 5.4


def test_the_doctor_names_who_holds_the_port(tmp_path):
    board = get_emulator("lcus")(4, WallClock())
    port = board.start()
    holder = subprocess.Popen(
        [sys.executable, "-c", f"import time; f = open({port!r}, 'rb', 0); time.sleep(20)"]
    )
    try:
        deadline = time.monotonic() + 10
        while (found := doctor.check_port_holders(port)).ok and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not found.ok and str(holder.pid) in found.text
    finally:
        holder.kill()
        holder.wait()
        board.close()


def test_the_doctor_takes_no_emulator_for_a_thief(tmp_path):
    """It has its own pseudo-terminal open at both ends."""
    command = [sys.executable, "-c", "from eldir_app.commands.rig import rig; rig()", "emulate"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as board:
        found = doctor.check_port_holders(board.stdout.readline().strip())
        board.terminate()
    assert found.ok, found.text


def test_the_doctor_looks_at_camera_and_calibration(tmp_path):
    film = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (64, 48))
    for _ in range(30):
        film.write(np.full((48, 64, 3), 250, np.uint8))
    film.release()
    rate, exposure = doctor.check_camera(str(tmp_path / "film.avi"))
    assert rate.ok and "20.0 frames" in rate.text
    assert not exposure.ok and "set the exposure" in exposure.text
    assert not doctor.check_camera(str(tmp_path / "none.avi"))[0].ok
    for days, ok in ((30.0, True), (-1.0, False)):
        import json

        path = tmp_path / "plane.json"
        path.write_text(json.dumps({"provenance": validity_period(days)}))
        assert doctor.check_calibration(path).ok is ok
    path.write_text("{}")
    assert not doctor.check_calibration(path).ok


def test_help_of_every_command_has_an_example():
    for name in ("new", "off", "reset", "drive", "emulate", "doctor"):
        assert "Example" in CliRunner().invoke(command, [name, "--help"]).output


def test_a_board_is_not_emulated_with_more_channels_than_it_can_have():
    for kind, most in (("lcus", 8), ("gd32", 14), ("sainsmart", 16)):
        refused = run("emulate", "--board", kind, "--channels", most + 1)
        assert refused.exit_code == 2 and f"at most {most}" in refused.output


def test_a_trace_of_switchings_overwrites_no_file(tmp_path):
    trace = tmp_path / "edges.jsonl"
    trace.write_text("kept")
    command = [sys.executable, "-m", "eldir", "rig", "emulate", "--trace", trace]
    refused = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert refused.returncode == 1 and refused.stdout == "" and trace.read_text() == "kept"
    assert "edges.jsonl exists already" in refused.stderr and refused.stderr.count("\n") == 1


def test_the_folder_of_a_trace_is_made(tmp_path):
    trace = tmp_path / "new" / "folder" / "edges.jsonl"
    command = [sys.executable, "-m", "eldir", "rig", "emulate", "--trace", trace]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline().startswith(b"/dev/")
            assert trace.exists()
        finally:
            process.terminate()
