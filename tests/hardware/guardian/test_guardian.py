"""The guardian process on a real pseudo-terminal: whoever orders the heat may die, hang or forget."""

import os
import signal
import time
from pathlib import Path

import pytest

from eldir.errors import EldirError
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.latch import LatchedError, latch, read_stop
from eldir_hardware.safety.spring_memory import load_springs
from eldir_hardware.safety.stop_signals import StoppedError
from tests.hardware.emulated_rigs import emulated, heating_program, in_turn, rig_file, run, wait
from tests.raised import raises

KINDS = ("lcus", "modbus", "mosfet")


def boards(*these: str):
    """The test runs on these boards, and on the others as a stress test: what they do differently is tested
    with each of them."""
    kinds = [pytest.param(k, marks=[] if k in these else pytest.mark.stress) for k in KINDS]
    return pytest.mark.parametrize("bench", kinds, indirect=True)


@pytest.fixture
def bench(request, tmp_path):
    """An emulated board, and the file of a rig on its port."""
    with emulated(request.param) as board:
        yield board, rig_file(tmp_path / "rig.yaml", request.param, board.port)


@pytest.fixture
def heating(bench):
    """... and a program that heats channels 1 and 3 through a guardian."""
    board, path = bench
    with heating_program(board, path) as (program, guardian):
        yield board, path, program, guardian


@boards("lcus", "mosfet")
def test_pulses_reports_and_a_good_end(bench):
    board, path = bench
    seen = []
    with Guardian(Rig.load(path)) as bank, bank.armed():
        start = time.monotonic() + 0.4
        bank.heat(start, {1: 0.6, 4: 0.4})
        bank.wait_until(start + 1.0, seen.append)
    assert [(e.channel, e.closed) for e in sorted(board.contact_events)] == [
        (1, True),
        (4, True),
        (4, False),
        (1, False),
    ]
    spans = {e.channel: e.t - start for e in board.contact_events if not e.closed}
    assert spans == pytest.approx({4: 0.4, 1: 0.6}, abs=0.15)
    assert any(r.closed == (True, False, False, True) for r in seen)
    assert 22.0 < seen[-1].peak == max(r.peak for r in seen) < 40
    assert read_stop(board.port) is None


@boards("lcus")
def test_a_parent_that_stands_still(heating):
    board, _, program, _ = heating
    stood = time.monotonic()
    os.kill(program.pid, signal.SIGSTOP)
    assert wait(lambda: not any(board.contacts))
    assert max(e.t for e in board.contact_events) - stood < 1.0
    os.kill(program.pid, signal.SIGCONT)
    assert program.wait(10) == 1
    assert (
        "no keepalive message of the program that heats for" in (text := program.stderr.read())
        and "all contacts are open" in text
    )


@boards("modbus")
def test_a_parent_that_is_killed(heating):
    """Told by the closed socket, before a heartbeat is missed."""
    board, _, program, _ = heating
    died = time.monotonic()
    program.kill()
    assert wait(lambda: not any(board.contacts))
    assert max(e.t for e in board.contact_events) - died < 1.0
    assert wait(lambda: "the program that heats has died" in (read_stop(board.port) or ""))


@pytest.mark.parametrize(("bench", "how"), in_turn(KINDS[:2], ["died", "hung"]), indirect=["bench"])
def test_a_guardian_that_dies_or_hangs(heating, how):
    """Its parent opens the contacts; a board that times its pulses has opened them before."""
    board, _, program, guardian = heating
    died = time.monotonic()
    os.kill(guardian, signal.SIGKILL if how == "died" else signal.SIGSTOP)
    assert wait(lambda: not any(board.contacts))
    assert max(e.t for e in board.contact_events) - died < (1.0 if how == "died" else 2.5)
    assert program.wait(10) == 1
    assert f"the guardian {how}; all contacts are open" in program.stderr.read()
    assert f"the guardian {how}" in (read_stop(board.port) or "")


@boards("lcus", "modbus")
def test_both_killed(heating):
    """Only a board that times its pulses still opens them; on the others the cut-off does."""
    board, _, program, guardian = heating
    program.send_signal(signal.SIGSTOP)
    os.kill(guardian, signal.SIGKILL)
    died = time.monotonic()
    program.kill()
    timed = type(board).__name__ != "EmulatedLcus"
    assert wait(lambda: not any(board.contacts), 1.0) is timed
    if timed:
        assert max(e.t for e in board.contact_events) - died < 0.6
    assert "the guardian that drove it died" in (read_stop(board.port) or "")


@boards("lcus")
def test_off_from_another_terminal_is_latched_until_reset(heating):
    board, path, program, _ = heating
    asked = time.monotonic()
    result = run("off", "--rig", path)
    assert result.exit_code == 0 and "all 4 channels are open" in result.output
    assert max(e.t for e in board.contact_events) - asked < 1.0 and not any(board.contacts)
    assert program.wait(10) == 1 and "eldir rig off" in program.stderr.read()
    rig = Rig.load(path)
    with Guardian(rig) as bank, pytest.raises(LatchedError, match="eldir rig off"), bank.armed():
        pass
    assert run("reset", "--rig", path).exit_code == 0
    with Guardian(rig) as bank, bank.armed():
        pass


@boards("lcus")
def test_a_reset_is_refused_while_a_contact_stays_closed(bench):
    board, path = bench
    board.set_coil(2, True)
    board.faults.deaf.add(2)
    latch(board.port, "for a reason")
    result = run("reset", "--rig", path)
    assert result.exit_code != 0 and "not proven" in str(result.exception)
    assert read_stop(board.port) is not None


@pytest.mark.parametrize(
    ("pulses", "code"),
    [
        ([(0.5, {1: 7.0})], "limit.long-pulse"),
        pytest.param([(0.5, {1: 0.5}), (1.5, {1: 0.5})], "limit.no-rest", marks=pytest.mark.stress),
        pytest.param([(0.5, {4: 0.5, 5: 0.5})], "limit.other-wiring", marks=pytest.mark.stress),
    ],
)
def test_what_the_guardian_refuses(tmp_path, pulses, code):
    """Whatever a program orders; afterwards everything is off, and latched."""
    with emulated("lcus") as board:
        rig = Rig.load(rig_file(tmp_path / "rig.yaml", "lcus", board.port))
        with Guardian(rig) as bank, raises(LimitError, code), bank.armed():
            now = time.monotonic()
            for after, lengths in pulses:
                bank.heat(now + after, lengths)
            bank.wait_until(now + 1.0)
        assert not any(board.contacts) and read_stop(board.port) is not None


def test_a_rig_without_measurements_does_not_even_start(tmp_path):
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port, springs={"resistance_ohm": None})
        with (
            raises(EldirError, "limit.not-measured", match="springs.resistance_ohm"),
            Guardian(Rig.load(path)),
        ):
            pass


@boards("mosfet")
def test_an_error_of_the_program_is_a_stop(bench):
    board, path = bench
    with Guardian(Rig.load(path)) as bank, pytest.raises(StoppedError), bank.armed():
        bank.heat(time.monotonic() + 0.3, {1: 2.0})
        bank.wait_until(time.monotonic() + 0.6)
        raise StoppedError("someone pressed a key")
    assert not any(board.contacts) and "pressed a key" in (read_stop(board.port) or "")


@boards("lcus")
def test_one_guardian_for_a_port(bench):
    _, path = bench
    rig = Rig.load(path)
    with Guardian(rig), raises(EldirError, "board.port-in-use", match="drives /dev/"), Guardian(rig):
        pass


@pytest.mark.parametrize(
    "times", [pytest.param(1, id="once"), pytest.param(50, id="fifty", marks=pytest.mark.stress)]
)
def test_after_unplugging_the_true_cause_is_told(times, tmp_path, monkeypatch):
    """At once, and at the next start: also where the port's link has gone with the board. Its springs count
    as hot then."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    for number in range(times):
        link = tmp_path / f"board{number}"
        kind = ("lcus", "modbus", "feedback")[number % 3]
        with emulated(kind) as board:
            link.symlink_to(board.port)
            rig = Rig.load(rig_file(tmp_path / "rig.yaml", kind, str(link)))
            told = ""
            try:
                with Guardian(rig) as bank, bank.armed():
                    bank.heat(time.monotonic() + 0.3, {1: 5.0, 3: 5.0})
                    unplugged = time.monotonic() + 0.5 + 0.13 * (number % 5)
                    bank.wait_until(unplugged)
                    link.unlink()
                    board.unplug()
                    bank.wait_until(unplugged + 5.0)
            except EldirError as error:
                told = str(error)
            assert f"the port {board.port} was lost" in told and "died" not in told
        with emulated(kind) as board:
            link.symlink_to(board.port)
            with Guardian(rig) as bank, pytest.raises(LatchedError, match="was lost"), bank.armed():
                pass
            assert load_springs(str(link)) is None
            refused = run("reset", "--rig", tmp_path / "rig.yaml")  # this may be another board
            assert refused.exit_code == 1 and "not proven open" in str(refused.exception)
            Path(str(refused.exception).rpartition("remove ")[2]).unlink()  # by a person who has looked
            assert run("reset", "--rig", tmp_path / "rig.yaml").exit_code == 0
            assert load_springs(str(link)).keys() == set(range(1, rig.board.channels + 1)), (
                "as hot as can be, now"
            )
            link.unlink()
