"""The fault matrix: real processes on a real pseudo-terminal, each fault in mid-heating.

For each: how long until all heat that can be switched is off, the peak temperature that the worst
spring would reach had it struck at the end of the longest pulse, what the user is told, and what the
log holds. `pytest -s` prints the rows of the table in docs/safety.md.
"""

import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from eldir.built.heat import HeatModel
from eldir.errors import EldirError
from eldir.lattice import Lattice
from eldir_hardware.clock import WallClock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recover import recover_log
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_emulator
from eldir_hardware.rig.port_holder import find_holder
from eldir_hardware.rig.supply import worst_springs
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.safety import limits
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.safety.latch import read_stop
from eldir_hardware.schedule import ActuationSchedule
from tests.eldir.random_design import make_design
from tests.forked_programs import Forked
from tests.hardware.emulated_rigs import rig_file, wait
from tests.hardware.rigs_and_schedules import gait, rig_text

STEP = 0.05


class Run(NamedTuple):
    """What a fault led to."""

    board: EmulatedBoard
    rig: Rig
    off_after: float
    """From the fault until the last contact that could open was open [s]."""
    told: str
    latched: bool
    log: Path

    @property
    def end(self) -> str:
        """The log's last word."""
        log = self.log
        with suppress(EldirError):
            return read_log(log).statuses[-1][2]
        whole = log.with_suffix(".recovered.mcap")
        if not whole.exists():
            recover_log(log, whole)
        return f"recovered, {len(read_log(whole).relay_times)} reports of the relays"


def peak_at_the_worst_moment(rig: Rig, off_after: float) -> float:
    """Of the hottest tolerated springs, on the whole gait, if the longest pulse lasted that much longer."""
    most = rig.limits.max_on_s
    pulse, period = min(most + off_after, rig.cutoff_s or np.inf), 20.0
    before = np.arange(round(5 * period / STEP)) * STEP % period < most
    last = np.arange(round(period / STEP)) * STEP < pulse
    on = np.concatenate([before, last]).astype(float)
    return float(HeatModel([worst_springs(rig)]).run(on[:, None], STEP).temperature.max())


def bench(tmp_path: Path, kind: str) -> tuple[EmulatedBoard, Path, Path]:
    """An emulated board, a rig file on its port, and a short schedule that heats all four springs at once."""
    board = get_emulator(kind)(4, WallClock())
    rig = rig_file(tmp_path / "rig.yaml", kind, board.start())
    loaded = Rig.load(rig)
    compiled = compile_schedule(gait(phase=(0.0, 0.01), duty=(0.25, 0.25)), loaded, (7, 12), cycles=1)
    short = replace(compiled, settle_s=0.0, conditioning_cycles=0)
    with_digests(short, loaded).save(tmp_path / "schedule.json")
    return board, rig, tmp_path / "schedule.json"


def heating(board: EmulatedBoard) -> bool:
    """For long enough that the log has it on the disk, and still."""
    return wait(lambda: all(board.contacts), 12.0) and not time.sleep(0.8) and all(board.contacts)


def off_after(board: EmulatedBoard, struck: float, patience: float = 6.0) -> float:
    """From the fault to the last edge of the contacts that can open."""
    can_open = [c for c in range(1, 5) if c not in board.faults.welded]
    wait(lambda: not any(board.contacts[c - 1] for c in can_open), patience)
    assert not any(board.contacts[c - 1] for c in can_open)
    return max(max(e.t for e in board.contact_events if e.channel in can_open and not e.closed) - struck, 0.0)


def patiently(play: Callable[..., Run]) -> Callable[..., Run]:
    """Again where a machine that does too much else ended the run before the fault: that is another fault."""

    @wraps(play)
    def again(tmp_path: Path, *arguments: object) -> Run:
        for attempt in range(3):
            folder = tmp_path / str(attempt)
            folder.mkdir()
            try:
                return play(folder, *arguments)
            except NotHeatingError as error:
                print(error)
        raise AssertionError("heating never began")

    return again


class NotHeatingError(Exception):
    """The run ended before the fault."""


@patiently
def within(tmp_path: Path, fault: Callable[[EmulatedBoard], object], kind: str = "lcus") -> Run:
    """A fault of the board: the schedule is played in a thread, its guardian is a process."""
    board, rig, schedule = bench(tmp_path, kind)
    log, told = tmp_path / "log.mcap", []

    def play() -> None:
        try:
            drive_rig(ActuationSchedule.load(schedule), Rig.load(rig), rig, log)
        except EldirError as error:
            told.append(str(error))

    thread = threading.Thread(target=play)
    thread.start()
    try:
        if not heating(board):
            raise NotHeatingError(told)
        struck = time.monotonic()
        struck = fault(board) or struck
        seconds = off_after(board, struck)
        thread.join(20)
        assert not thread.is_alive()
        latched = read_stop(board.port) is not None
    finally:
        board.faults.silent = True  # a thread that is left ends soon
        thread.join(20)
        board.close()
    return Run(board, Rig.load(rig), seconds, told[0] if told else "", latched, log)


@patiently
def beside(tmp_path: Path, fault: Callable[[EmulatedBoard, Forked], object], kind: str = "lcus") -> Run:
    """A fault of a process: the schedule is played by `eldir rig drive`."""
    board, rig, schedule = bench(tmp_path, kind)
    log = tmp_path / "log.mcap"
    command = [sys.executable, "-c", "from eldir_app.main import main; main()", "rig", "drive"]
    with Forked(
        [*command, str(schedule), "--rig", str(rig), "--log", str(log)],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as process:
        try:
            if not heating(board):
                process.kill()
                raise NotHeatingError(process.communicate())
            struck = time.monotonic()
            struck = fault(board, process) or struck
            seconds = off_after(board, struck)
            _, told = process.communicate(timeout=20)
            latched = wait(lambda: read_stop(board.port) is not None, 2.0)
        finally:
            process.kill()
            board.close()
    return Run(board, Rig.load(rig), seconds, told, latched, log)


def guardian_of(board: EmulatedBoard) -> int:
    return find_holder(board.port).process


THIEF = """
import os, sys, time
handle = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
while True:
    try:
        if os.read(handle, 4096):
            print(time.monotonic(), flush=True)
    except BlockingIOError:
        pass
"""


def thief(board: EmulatedBoard) -> float:
    """Another program opens the port, which only the superuser can, and takes what comes from the board."""
    other = subprocess.Popen([sys.executable, "-c", THIEF, board.port], stdout=subprocess.PIPE, text=True)
    threading.Timer(10.0, lambda: (other.kill(), other.wait(), other.stdout.close())).start()
    if not (stolen := other.stdout.readline()):
        raise NotHeatingError("the thief took nothing: the run had ended before")
    return float(stolen)


def full_disk(board: EmulatedBoard, process: Forked) -> None:
    """Neither process can write a file beyond this size any more."""
    for number in (process.pid, guardian_of(board)):
        resource.prlimit(number, resource.RLIMIT_FSIZE, (1, 1))


def both_stand_still(board: EmulatedBoard, process: Forked) -> None:
    """As when a computer sleeps or a clock jumps: nobody runs, then it is two seconds later."""
    guardian = guardian_of(board)
    for number in (process.pid, guardian):
        os.kill(number, signal.SIGSTOP)
    time.sleep(0.8)
    for number in (guardian, process.pid):
        os.kill(number, signal.SIGCONT)


def kill(board: EmulatedBoard, process: Forked) -> float:
    """When the log has something on the disk, which it has after half a second."""
    time.sleep(1.0)
    if process.poll() is not None:
        raise NotHeatingError("the run ended before it could be killed")
    now = time.monotonic()
    process.kill()
    return now


OF_THE_BOARD = {
    "unplugged": ("lcus", lambda b: b.unplug(), "port .* was lost|cannot|did not answer"),
    "board reset": ("lcus", lambda b: b.reset(), "did not switch; expected closed; found open"),
    "no answer": ("lcus", lambda b: setattr(b.faults, "silent", True), "did not answer"),
    "late answer": ("lcus", lambda b: setattr(b.faults, "late", 0.7), "did not answer"),
    "garbled answer": ("lcus", lambda b: setattr(b.faults, "garbled", True), "cannot be read"),
    "no answer, timed board": ("modbus", lambda b: setattr(b.faults, "silent", True), "did not answer"),
    "port stolen": ("lcus", thief, "did not answer|cannot be read|was lost"),
}
OF_A_PROCESS = {
    "SIGINT": ("lcus", lambda b, p: p.send_signal(signal.SIGINT), "interrupted|Ctrl-C", 130),
    "SIGTERM": ("lcus", lambda b, p: p.send_signal(signal.SIGTERM), "stopped by SIGTERM", 1),
    "SIGKILL of the player": ("lcus", kill, "the program that heats has died", -9),
    "SIGKILL of the guardian": (
        "modbus",
        lambda b, p: os.kill(guardian_of(b), signal.SIGKILL),
        "the guardian died; all contacts are open",
        1,
    ),
    "full disk": ("lcus", full_disk, "cannot write|cannot be written|File too large", 1),
    "computer asleep for 0.8 s": ("modbus", both_stand_still, "was suspended|no keepalive message", 1),
}


def report(name: str, run: Run) -> None:
    peak = peak_at_the_worst_moment(run.rig, run.off_after)
    told = run.told.strip().splitlines()[-1].removeprefix("eldir: ") if run.told else ""
    end = "nothing" if not run.log.exists() else run.end
    print(f"\n| {name} | {run.off_after:.2f} s | {peak:.0f} C | {told} | {end} |")
    assert peak < 90.0


LONG = ("late answer", "no answer, timed board", "SIGKILL of the guardian", "computer asleep for 0.8 s")
"""Of these, tests of the guardian show the same: they are stress tests."""


def in_brief(names: Iterable[str]) -> list:
    return [pytest.param(n, marks=[pytest.mark.stress] if n in LONG else []) for n in names]


@pytest.mark.parametrize("name", in_brief(OF_THE_BOARD))
def test_faults_of_the_board(name, tmp_path):
    kind, fault, told = OF_THE_BOARD[name]
    run = within(tmp_path, fault, kind)
    report(name, run)
    assert re.search(told, run.told)
    assert "cut the heating supply" in run.told or "all contacts are open" in run.told
    assert run.off_after < (1.0 if name == "port stolen" else 0.5)
    assert re.search(told, run.end), "the log says why"


@pytest.mark.parametrize("name", in_brief(OF_A_PROCESS))
def test_faults_of_a_process(name, tmp_path):
    kind, fault, told, status = OF_A_PROCESS[name]
    codes = []

    def strike(board: EmulatedBoard, process: Forked) -> object:
        codes.append(process)
        return fault(board, process)

    run = beside(tmp_path, strike, kind)
    report(name, run)
    assert codes[0].returncode == status
    assert re.search(told, run.told)
    assert run.off_after < (1.0 if name.startswith(("SIGKILL", "computer")) else 0.5)  # no longer lives
    assert run.latched
    if name != "full disk":
        assert re.search(f"{told}|recovered, [1-9]|stopped", run.end)


def test_a_stuck_contact(tmp_path):
    """The board does not know: the cut-off ends it, within what layer 0 asked of it."""
    board, rig, schedule = bench(tmp_path, "lcus")
    board.close()
    loaded = Rig.load(rig)
    prediction = limits.check_schedule(ActuationSchedule.load(schedule), loaded)
    assert peak_at_the_worst_moment(loaded, np.inf) < 90 and prediction.stuck_c < 90
    print(f"\n| stuck contact | {loaded.cutoff_s:g} s, by the cut-off | {prediction.stuck_c:.0f} C |")


def test_a_stuck_contact_that_the_board_reports(tmp_path):
    """All others open at once."""

    def stick(board: EmulatedBoard) -> None:
        board.faults.welded.add(2)
        board.faults.deaf.add(2)

    board_run = within(tmp_path, stick)
    report("stuck contact, reported", board_run)
    assert board_run.off_after < 6
    assert "relay channel 2 did not switch" in board_run.told
    assert "cut the heating supply" in board_run.told


@pytest.mark.parametrize(
    ("configured", "real"), [("lcus", "feedback"), pytest.param("feedback", "gd32", marks=pytest.mark.stress)]
)
def test_a_wrong_dialect_never_heats(configured, real, tmp_path):
    emulated = get_emulator(real)(4, WallClock())
    path = rig_file(tmp_path / "rig.yaml", configured, emulated.start())
    _, _, schedule = bench(tmp_path, configured)
    (tmp_path / "rig.yaml").unlink()
    path = rig_file(tmp_path / "rig.yaml", configured, emulated.port)
    with pytest.raises(EldirError) as told:
        drive_rig(ActuationSchedule.load(schedule), Rig.load(path), path, tmp_path / "log.mcap")
    print(f"\n| wrong dialect | never on | ambient | {told.value} |")
    assert "not proven that everything is off" in str(told.value)
    assert emulated.contact_events == []
    emulated.close()


@pytest.mark.realtime
def test_neither_a_stalled_camera_nor_the_engine_touches_the_heat(tmp_path, monkeypatch):
    design = make_design(3, Lattice(3, 6))
    design.save(tmp_path / "design.json")
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig_text(4, "design.json", clock="wall"))
    compiled = compile_schedule(gait(phase=(0.0, 0.01), duty=(0.08, 0.08)), Rig.load(rig), (7, 12), cycles=1)
    schedule = replace(compiled, period_s=10.0, settle_s=0.0, conditioning_cycles=0)
    schedule = with_digests(schedule, Rig.load(rig), design)
    stalled = []

    def here(*_: object) -> None:
        raise AssertionError("the engine would hold up the emulated board in this process")

    monkeypatch.setattr("eldir_hardware.virtual.bodies.virtual_body", here)

    def stall(frame) -> None:
        if frame.time_s > 1.0 and not stalled:
            stalled.append(frame.time_s)
            time.sleep(1.5)

    played = drive_rig(schedule, Rig.load(rig), rig, tmp_path / "log.mcap", DriveConfig(on_body=stall))
    log = read_log(tmp_path / "log.mcap")
    assert stalled and played.max_delay_s < 0.3
    assert next(t for t, part, _ in log.statuses if part == "files") == 0.0, "at the schedule's start"
    told = next(text for _, part, text in log.statuses if part == "camera")
    assert re.search("no frame for [12]", told)
    print(f"\n| camera stall | heat goes on as scheduled | {played.peak_c:.0f} C | | {told} |")
