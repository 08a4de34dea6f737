"""What the MOSFET board requires of a rig file, and the files that it gets from one."""

from pathlib import Path

import pytest

from eldir.errors import EldirError, InputError
from eldir_app.doctor import examine
from eldir_app.switching_checks import measure_retriggerable
from eldir_hardware.clock import WallClock
from eldir_hardware.emulator.mosfet import EmulatedMosfet
from eldir_hardware.firmware import limits
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_requirements, is_retriggerable
from eldir_hardware.rig.sections import ContactorEntry
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.rig.template import real_rig
from eldir_hardware.safety.latch import read_stop
from eldir_hardware.safety.worst_heat import check_board
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.emulated_rigs import rig_file, run
from tests.hardware.relay.mosfet_bench import RIG, bench
from tests.hardware.rigs_and_schedules import rig_text, rig_with
from tests.hardware.virtual.piston_and_observer import Piston
from tests.raised import raises


@pytest.mark.parametrize(
    ("change", "steady", "code", "message"),
    [
        (
            {"limits": {"max_on_s": 6.15}, "cutoff": None},
            (),
            "limits",
            "longest pulse; expected 6.1 s",
        ),
        ({"limits": {"duty": 0.6}}, (), "limits", ": duty; expected 0.5"),
        ({"board": {"channels": 9}}, (), "limits", "number of channels; expected 8"),
        (
            {"fan": {"interlocked": True, "channel": 5}, "board": {"channels": 5}},
            (),
            "channels",
            r"found channels \[5\]",
        ),
        (
            {},
            (4,),
            "channels",
            r"expected channels \[4\] without a heat budget.*; found channels \[4\] otherwise",
        ),
    ],
)
def test_a_rig_file_looser_than_the_board_does_not_arm(change, steady, code, message, monkeypatch) -> None:
    monkeypatch.setattr(limits, "STEADY", steady)
    rig = rig_with(**{"board": {"kind": "mosfet"} | change.pop("board", {})}, **change)
    with bench(channels=8) as (emulated, board, _):
        board.channels = rig.board.channels
        with raises(InputError, f"board.other-{code}", match=message):
            board.check_limits(get_requirements(rig))
        assert emulated.contact_events == []


def test_in_virtual_time_too() -> None:
    rig = rig_with(board={"kind": "mosfet"}, limits={"duty": 0.6})
    with (
        VirtualRig(rig, Piston()) as virtual,
        raises(InputError, "board.other-limits", match=r": duty; expected 0\.5"),
    ):
        PulseController(virtual.board, rig, virtual.clock).arm()


def test_a_fan_on_a_steady_channel_runs_while_the_springs_rest(monkeypatch) -> None:
    monkeypatch.setattr(limits, "STEADY", (5,))
    fan = {"interlocked": True, "channel": 5}
    rig = rig_with(board={"kind": "mosfet", "channels": 5}, fan=fan)
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with bank.armed():
            bank.wait_until(virtual.clock.now() + 15.0)
            assert virtual.emulator.contacts == (False, False, False, False, True)
        assert [e.closed for e in virtual.emulator.contact_events] == [True, False]


def test_it_needs_a_cutoff_as_any_board_does_and_cannot_be_its_own() -> None:
    own = rig_with(board={"kind": "mosfet", "channels": 5}, cutoff=None)
    own = own.model_copy(update={"cutoff": ContactorEntry(kind="contactor", channel=5)})
    with raises(LimitError, "limit.contactor-fails-closed"):
        check_board(own)
    with raises(LimitError, "limit.stuck-contact"), bench() as (_, board, clock):
        PulseController(board, rig_with(board={"kind": "mosfet"}, cutoff=None), clock)


def test_its_second_pulse_need_not_be_measured_but_can_be() -> None:
    check_board(RIG)
    assert is_retriggerable(RIG) is True, "pulses are sent in short steps, as they are repeated"
    for text in (rig_text(board="mosfet"), real_rig("mosfet", "/dev/ttyACM0")):
        assert "\n  retriggerable:" not in text
    with bench() as (_, board, clock):
        assert measure_retriggerable(board, clock, 1) is True


def test_the_guardian_refuses_such_a_rig_file_and_latches_nothing(tmp_path) -> None:
    board = EmulatedMosfet(4, WallClock())
    path = rig_file(tmp_path / "rig.yaml", "mosfet", board.start(), limits={"duty": 0.7})
    try:
        with (
            raises(EldirError, "board.other-limits", match=r": duty; expected 0\.5"),
            Guardian(Rig.load(path)) as bank,
            bank.armed(),
        ):
            raise AssertionError("armed")
        assert read_stop(board.port) is None
        assert board.contact_events == []
    finally:
        board.close()


def test_the_doctor_compares_the_limits(tmp_path) -> None:
    board = EmulatedMosfet(4, WallClock())
    path = rig_file(tmp_path / "rig.yaml", "mosfet", board.start(), limits={"duty": 0.7})
    found = {f.subject: f for f in examine(Rig.load(path), tmp_path)}
    board.close()
    assert not found["board"].ok and ": duty; expected 0.5" in found["board"].text


# The files for the board.


TIGHTER = {"max_on_s": 4.0, "duty": 0.3}


def test_the_files_for_the_board_keep_the_limits_of_the_rig(tmp_path) -> None:
    path = rig_file(tmp_path / "rig.yaml", "mosfet", "/dev/ttyACM0", limits=TIGHTER)
    result = run("firmware", "--rig", path, "--out", tmp_path / "files")
    assert result.exit_code == 0, result.output
    values: dict[str, object] = {}
    exec((tmp_path / "files" / "limits.py").read_text(), values)
    assert values["MAX_ON_MS"] == 4200 and values["DUTY_PERCENT"] == 30
    assert values["PINS"] == (0, 1, 2, 3) and values["STEADY"] == ()
    assert values["HEARTBEAT_MS"] == limits.HEARTBEAT_MS
    names = {p.name for p in (tmp_path / "files").iterdir()}
    ours = {p.name for p in Path(limits.__file__).parent.glob("[!_]*.py")}
    assert names == ours - {"current_sensor.py"}, "every file that main.py needs"
    again = run("firmware", "--out", tmp_path / "files")
    assert again.exit_code != 0 and "exists already" in str(again.exception)


def test_the_board_of_these_files_takes_its_rig(tmp_path, monkeypatch) -> None:
    path = rig_file(tmp_path / "rig.yaml", "mosfet", "/dev/ttyACM0", limits=TIGHTER)
    assert run("firmware", "--rig", path, "--out", tmp_path / "files").exit_code == 0
    values: dict[str, object] = {}
    exec((tmp_path / "files" / "limits.py").read_text(), values)
    for name in ("MAX_ON_MS", "DUTY_PERCENT", "STEADY"):
        monkeypatch.setattr(limits, name, values[name])
    rig = Rig.load(path)
    with bench() as (_, board, _clock):
        board.check_limits(get_requirements(rig))
        looser = rig.model_copy(update={"limits": rig.limits.model_copy(update={"duty": 0.31})})
        with raises(InputError, "board.other-limits", match=r": duty; expected 0\.3"):
            board.check_limits(get_requirements(looser))
