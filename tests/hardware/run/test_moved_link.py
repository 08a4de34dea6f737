"""A link to a board's port that is moved to another board, or removed, while a run heats through it."""

import json
import os
import re
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jsonschema
import pytest

from eldir.errors import EldirError
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.guardian.measured_heat import CurrentFlowsError
from eldir_hardware.rig.board_identity import describe_move, identify, identify_open, locate
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.port_holder import list_guarded_ports
from eldir_hardware.safety.latch import GUARDIAN_DIED, find_record, read_records
from eldir_hardware.safety.spring_memory import load_springs
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.emulated_rigs import emulated, heating_program, in_turn, rig_file, run, wait
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston
from tests.paths import ROOT

pytestmark = pytest.mark.usefixtures("state_folder")
SENSOR = {"kind": "ina3221"}
OPEN = "all 4 channels are open by the board's report"


class Bench:
    """A rig whose port is a link, and a second board of the same kind."""

    def __init__(self, folder: Path, first: EmulatedBoard, second: EmulatedBoard, kind: str):
        self.first, self.second, self.link = first, second, folder / "board"
        self.link.symlink_to(first.port)
        self.rig = rig_file(folder / "rig.yaml", kind, str(self.link))

    def move(self) -> None:
        self.remove()
        self.link.symlink_to(self.second.port)

    def remove(self) -> None:
        self.link.unlink()

    def opens(self) -> bool:
        return wait(lambda: not any(self.first.contacts), 3.0)


@contextmanager
def bench(folder: Path, kind: str = "lcus") -> Iterator[Bench]:
    with emulated(kind) as first, emulated(kind) as second:
        yield Bench(folder, first, second, kind)


@pytest.mark.parametrize(("kind", "strike"), in_turn(["lcus", "modbus"], [None, signal.SIGSTOP]))
def test_rig_off_opens_the_device_of_the_run_and_the_one_that_the_link_names_now(kind, strike, tmp_path):
    with bench(tmp_path, kind) as b, heating_program(b.first, b.rig) as (_, guardian):
        b.move()
        b.second.set_coil(2, True)
        if strike is not None:
            os.kill(guardian, strike)
        off = run("off", "--rig", b.rig)
        assert not any(b.first.contacts) and not any(b.second.contacts), off.output
        assert off.exit_code == 0, off.exception
        lines = [x for x in off.stdout.splitlines() if "is driven too" not in x]  # by other tests
        assert f"note: {b.link} names {b.second.port} now, and the run drove {b.first.port}" in lines
        assert lines[1].startswith(f"{b.first.port}: stopped process {guardian}; ") and OPEN in lines[1]
        assert lines[2] == f"{b.link}: {OPEN}"
        assert guardian not in [g.process for g in list_guarded_ports()]
        assert {r.identity.name for r in read_records()[0].values() if r.opened} == {
            b.first.port, b.second.port,
        }  # fmt: skip


@pytest.mark.parametrize("silent", ["first", "second"])
def test_rig_off_fails_where_one_of_both_is_not_proven(silent, tmp_path):
    with bench(tmp_path) as b, heating_program(b.first, b.rig):
        b.move()
        getattr(b, silent).faults.silent = True
        off = run("off", "--rig", b.rig)
        assert off.exit_code == 1 and b.opens()
        unproven = b.first.port if silent == "first" else b.link
        assert f"not proven that everything is off at {unproven}" in str(off.exception)
        assert bool(find_record(b.first.port).opened) is (silent == "second")


def test_rig_off_of_the_link_or_of_the_device(tmp_path, state_folder):
    schema = json.loads((ROOT / "docs" / "schemas" / "board.schema.json").read_text())
    with bench(tmp_path) as b, heating_program(b.first, b.rig) as (_, guardian):
        (file,) = state_folder.glob("board-*.json")
        jsonschema.validate(json.loads(file.read_text()), schema)
        b.move()
        (mine,) = (g for g in list_guarded_ports() if g.process == guardian)
        assert (mine.port, mine.given_name) == (b.first.port, str(b.link))
        off = run("off", "--port", b.link)
        assert off.exit_code == 0 and off.stdout.count(OPEN) == 2 and not any(b.first.contacts)
        off = run("off", "--port", mine.port)
        assert off.exit_code == 0 and off.stdout.count(OPEN) == 1, "a device's own name is no other's"


@pytest.mark.parametrize(("words", "strike"), in_turn(["--rig", "--port"], [None, signal.SIGSTOP]))
def test_a_link_that_was_removed(words, strike, tmp_path):
    with bench(tmp_path) as b, heating_program(b.first, b.rig) as (_, guardian):
        b.remove()
        if strike is not None:
            os.kill(guardian, strike)
        off = run("off", words, b.rig if words == "--rig" else b.link)
        assert not any(b.first.contacts), off.output
        assert off.exit_code == 0 and f"{b.link} has gone, and the run drove {b.first.port}" in off.stdout
        assert re.search(rf"^{b.first.port}: stopped process {guardian}; .*{OPEN}$", off.stdout, re.M)
        assert not wait(lambda: guardian in [g.process for g in list_guarded_ports()], 0.0)


@pytest.mark.parametrize(("strike", "how"), in_turn([signal.SIGKILL, signal.SIGSTOP], ["move", "remove"]))
def test_the_program_whose_guardian_dies_or_hangs_opens_the_device_of_the_run(strike, how, tmp_path):
    with bench(tmp_path) as b, heating_program(b.first, b.rig) as (program, guardian):
        getattr(b, how)()
        begun = time.monotonic()
        os.kill(guardian, strike)
        assert b.opens(), "the first board heats on"
        assert max(e.t for e in b.first.contact_events) - begun < 1.5
        told = program.communicate(timeout=10)[1].splitlines()[-1]
        now = f"names {b.second.port} now" if how == "move" else "has gone"
        died = "died" if strike == signal.SIGKILL else "hung"
        run_drove = rf"\({b.link} {now}, and the run drove {b.first.port}\)"
        assert re.search(
            rf"the guardian {died} {run_drove}; all contacts are open by the board's report$", told
        )
        assert not b.second.contact_events, "its frames are not for the other board"
        assert find_record(b.first.port).opened is not None and find_record(b.second.port) is None


def test_no_proof_is_taken_from_the_other_board(tmp_path):
    """The first one hears and does not answer: that the second one is open proves nothing."""
    with bench(tmp_path) as b, heating_program(b.first, b.rig) as (program, guardian):
        b.move()
        b.first.faults.silent = True
        os.kill(guardian, signal.SIGKILL)
        told = program.communicate(timeout=20)[1].splitlines()[-1]
        assert "the contacts cannot be opened" in told and "cut the heating supply now" in told
        assert find_record(b.first.port).opened is None


def test_the_end_that_the_guardian_tells_names_both(tmp_path):
    with bench(tmp_path) as b, heating_program(b.first, b.rig) as (program, guardian):
        b.move()
        os.kill(guardian, signal.SIGTERM)
        told = program.communicate(timeout=10)[1].splitlines()[-1]
        assert b.opens() and "all contacts are open by the board's report" in told
        assert f"{b.link} names {b.second.port} now, and the run drove {b.first.port}" in told


def left_by_both_killed(b: Bench) -> None:
    """Both programs are killed: the record is all that is left, and the board of the run heats."""
    with heating_program(b.first, b.rig) as (program, guardian):
        os.kill(program.pid, signal.SIGKILL)
        os.kill(guardian, signal.SIGKILL)
        assert wait(lambda: guardian not in [g.process for g in list_guarded_ports()])
    if not any(b.first.contacts):  # the guardian was quicker than its end
        b.first.set_coil(1, True)


def test_a_reset_before_the_device_of_the_run_was_proven_open_is_refused(tmp_path):
    with bench(tmp_path) as b:
        left_by_both_killed(b)
        b.move()
        told = run("drive", tmp_path / "none.json", "--rig", b.rig, "--log", tmp_path / "log.mcap")
        assert told.exit_code != 0
        reset = run("reset", "--rig", b.rig)
        (file,) = (n for n, r in read_records()[0].items() if r.identity.name == b.first.port)
        assert reset.exit_code == 1 and "the stop is reset" not in reset.output
        assert re.search(
            rf"the contacts of the run are not proven open: {b.link} names {b.second.port} now, and "
            rf"the run drove {b.first.port}; connect it where it was, then: eldir rig off.*{file}",
            str(reset.exception),
        )
        assert find_record(b.first.port).stop == GUARDIAN_DIED
        off = run("off", "--rig", b.rig)
        assert off.exit_code == 0 and not any(b.first.contacts) and off.stdout.count(OPEN) == 2
        reset = run("reset", "--rig", b.rig)
        assert reset.exit_code == 0, reset.exception
        assert not read_records()[0] and load_springs(str(b.link)) is not None
        assert load_springs(b.first.port), "its springs are at most at the ceiling, and cool"


def test_a_reset_through_the_device_s_own_name(tmp_path):
    """The link is back where it was: the run's device proves itself."""
    with bench(tmp_path) as b:
        left_by_both_killed(b)
        b.move()
        assert run("reset", "--rig", b.rig).exit_code == 1
        b.remove()
        b.link.symlink_to(b.first.port)
        assert run("reset", "--rig", b.rig).exit_code == 0 and not any(b.first.contacts)


def test_a_device_that_is_no_longer_connected_is_not_proven_by_another(tmp_path):
    with emulated("lcus") as second:
        with emulated("lcus") as first:
            b = Bench(tmp_path, first, second, "lcus")
            left_by_both_killed(b)
            b.move()
        off = run("off", "--rig", b.rig)
        assert off.exit_code == 1 and f"not proven that everything is off at {first.port}" in str(
            off.exception
        )
        assert f"{b.link}: {OPEN}" in off.stdout
        reset = run("reset", "--rig", b.rig)
        assert f"the run drove {first.port}, which is not connected" in str(reset.exception)


# What a device is.


def test_where_a_device_is():
    with emulated("lcus") as board:
        device = identify(board.port)
        assert locate(device) == board.port and describe_move(board.port, device) == ""
        handle = os.open(board.port, os.O_RDWR | os.O_NOCTTY)
        assert identify_open(handle) == device and device.is_open_as(handle)
    assert locate(device) is None
    with emulated("lcus") as another:
        assert another.port == board.port or os.path.exists(another.port)
        assert locate(device) is None, "its number is another board's now"
        later = os.open(another.port, os.O_RDWR | os.O_NOCTTY)
        assert not device.is_open_as(later)
        os.close(later)
    os.close(handle)


def test_the_sensor_of_the_run_alone_says_that_no_current_flows(tmp_path):
    """Its link was moved to a second one, which sees no current: the run's own sensor is asked."""
    with (
        VirtualRig(rig_with(virtual={"clock": "wall"}, sensor=SENSOR), Piston()) as virtual,
        VirtualRig(rig_with(virtual={"clock": "wall"}, sensor=SENSOR), Piston()) as other,
    ):
        link, board = tmp_path / "sensor", virtual.emulator
        link.symlink_to(virtual.sensor_port)
        rig = Rig.load(
            rig_file(tmp_path / "rig.yaml", "lcus", board.port, sensor=SENSOR | {"port": str(link)})
        )
        with Guardian(rig) as guardian, pytest.raises(EldirError) as caught, guardian.armed():
            link.unlink()
            link.symlink_to(other.sensor_port)
            board.faults.welded.add(2)
            board.set_coil(2, True)
            os.kill(guardian.process, signal.SIGKILL)
            guardian.wait_until(time.monotonic() + 5)
        assert isinstance(caught.value, CurrentFlowsError) and "channel 2" in str(caught.value)
        for command in ("off", "reset"):
            told = run(command, "--rig", tmp_path / "rig.yaml")
            assert told.exit_code == 1 and "current flows in channel 2" in str(told.exception)
        assert find_record(board.port).sensor.name == virtual.sensor_port
        virtual.emulated_sensor.close()
        told = run("off", "--rig", tmp_path / "rig.yaml")
        assert "note: no current was measured: " in told.stdout and "is not connected" in told.stdout
        assert "no current flows" not in told.stdout
