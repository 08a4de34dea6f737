"""Stops that do not come from a living guardian: the current sensor is asked there too."""

import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from eldir.errors import EldirError
from eldir_hardware.current_sensor import SensorError
from eldir_hardware.guardian import measured_heat
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.guardian.measured_heat import CurrentFlowsError
from eldir_hardware.guardian.off_proof import proven_open, reset_emergency_stop
from eldir_hardware.rig.board_identity import Port, identify
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import open_sensor
from eldir_hardware.rig.port_holder import GuardedPort, Holder, find_holder, list_guarded_ports
from eldir_hardware.safety import off_targets
from eldir_hardware.safety.latch import find_record, latch, latch_for_driving, read_stop
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.emulated_rigs import rig_file, run
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston

SENSOR = {"kind": "ina3221"}


OPEN = "all contacts are open by the board's report"
ONLY_2 = (
    r"no current flows in channel 2 by the sensor \(it measured the supply in it in this run\); "
    "the sensor shows no current in channels 1, 3, 4, but it has not measured the supply there in this run"
)


@contextmanager
def bench(folder: Path, inputs: list[int] | None = None) -> Iterator[tuple[VirtualRig, Path]]:
    """Emulated board, springs and current sensor, and a real rig's file on their ports."""
    entry = SENSOR | {"channels": inputs}
    with VirtualRig(rig_with(virtual={"clock": "wall"}, sensor=entry), Piston()) as virtual:
        sensor = {**entry, "port": virtual.sensor_port}
        yield virtual, rig_file(folder / "rig.yaml", "lcus", virtual.emulator.port, sensor=sensor)


def weld(virtual: VirtualRig, channel: int, welded: bool = True) -> None:
    """The contact stays closed, which the board does not notice; or it opens again."""
    virtual.emulator.set_coil(channel, welded)
    (virtual.emulator.faults.welded.add if welded else virtual.emulator.faults.welded.discard)(channel)
    virtual.emulator.set_coil(channel, False)
    time.sleep(0.1)


def test_off_and_reset_find_a_welded_contact(tmp_path):
    with bench(tmp_path) as (virtual, path):
        weld(virtual, 4)
        for command in ("off", "reset"):
            result = run(command, "--rig", path)
            assert result.exit_code == 1
            assert "current flows in channel 4" in str(result.exception)
            assert "cut the heating supply now" in str(result.exception)
            assert read_stop(virtual.emulator.port) == "stopped by eldir rig off"
        weld(virtual, 4, False)
        for command in ("off", "reset"):
            result = run(command, "--rig", path)
            assert result.exit_code == 0, result.exception
            assert "the sensor shows no current in channels 1 to 4 (at most" in result.output
            assert "so this alone proves nothing" in result.output
        assert read_stop(virtual.emulator.port) is None


@contextmanager
def heating_channel_2(path: Path, monkeypatch) -> Iterator[Guardian]:
    """A real guardian that heats it; `eldir rig off` without a port finds no guardian of other programs."""
    with Guardian(Rig.load(path)) as bank, bank.armed():

        def own() -> list[GuardedPort]:
            return [g for g in list_guarded_ports() if g.process == bank.process]

        monkeypatch.setattr(off_targets, "list_guarded_ports", own)
        bank.heat(time.monotonic() + 0.3, {2: 4.0})
        bank.wait_until(time.monotonic() + 0.8)
        yield bank


@pytest.mark.parametrize("names_port", [False, True])
def test_off_without_a_rig_file_measures_with_the_sensor_of_the_run(tmp_path, monkeypatch, names_port):
    """Also later, when no guardian lives that could tell what it has measured."""
    with bench(tmp_path) as (virtual, path):
        words = ["off", *(["--port", virtual.emulator.port] if names_port else [])]
        with pytest.raises(CurrentFlowsError), heating_channel_2(path, monkeypatch) as bank:
            virtual.emulator.faults.welded.add(2)
            stopped = run(*words)
            size = len(json.dumps(find_record(virtual.emulator.port).sensor_entries))
            assert size < 8192, "of the 65536 bytes that are read of a record"
            bank.wait_until(time.monotonic() + 2.0)
        later = run(*words)
        for result in (stopped, later):
            assert result.exit_code == 1
            assert "current flows in channel 2" in str(result.exception)
            assert "cut the heating supply now" in str(result.exception)
        weld(virtual, 2, False)
        result = run(*words)
        assert result.exit_code == 0, result.exception
        assert "the sensor shows no current in channels 1 to 4 (at most" in result.output


def test_off_waits_for_a_program_that_measures_with_the_sensor(tmp_path, monkeypatch):
    """Such as the one that heated, after its guardian was killed."""
    with bench(tmp_path) as (virtual, path):
        with pytest.raises(CurrentFlowsError), heating_channel_2(path, monkeypatch):
            virtual.emulator.faults.welded.add(2)
        with ExitStack() as program:
            program.enter_context(open_sensor(Rig.load(path)))

            def find_and_end(port: Port) -> Holder | None:
                holder = find_holder(port)
                program.close()
                return holder

            monkeypatch.setattr(measured_heat, "find_holder", find_and_end)
            result = run("off", "--port", virtual.emulator.port)
        assert result.exit_code == 1 and "current flows in channel 2" in str(result.exception)


def test_off_does_not_need_the_sensor_and_reset_does(tmp_path):
    with bench(tmp_path) as (virtual, path):
        virtual.emulated_sensor.faults.silent = True
        result = run("off", "--rig", path)
        assert result.exit_code == 0
        assert "note: no current was measured: the current sensor at" in result.output
        result = run("reset", "--rig", path)
        assert result.exit_code == 1 and isinstance(result.exception, SensorError)
        assert read_stop(virtual.emulator.port) == "stopped by eldir rig off"


def test_a_program_with_a_port_of_its_own_resets_only_what_the_sensor_shows_off(tmp_path):
    """As the node of the relay board, whose parameter names the port."""
    with bench(tmp_path) as (virtual, path):
        rig, port = Rig.load(path), virtual.emulator.port
        rig = rig.model_copy(update={"board": rig.board.model_copy(update={"port": "/dev/none"})})
        latch(port, "tried")
        weld(virtual, 4)
        with pytest.raises(CurrentFlowsError, match=r"channel 4 .*cut the heating supply now"):
            reset_emergency_stop(rig, port)
        weld(virtual, 4, False)
        virtual.emulated_sensor.faults.silent = True
        with pytest.raises(SensorError, match="did not answer"):
            reset_emergency_stop(rig, port)
        assert read_stop(port) == "tried"
        virtual.emulated_sensor.faults.silent = False
        assert "the sensor shows no current in channels 1 to 4" in reset_emergency_stop(rig, port)
        assert read_stop(port) is None


def test_the_sensor_of_the_stopped_run_is_asked_whatever_the_rig_file_names_now(tmp_path):
    with bench(tmp_path) as (virtual, path):
        rig, port = Rig.load(path), virtual.emulator.port
        sensor = identify(virtual.sensor_port)
        elsewhere = rig.sensor.model_copy(update={"port": "/dev/none"})
        latch_for_driving(port, "lcus", 4, rig.name, sensor=sensor)
        with proven_open(rig, port) as (board, found):
            assert found.is_same_device(sensor) and board.is_same_device(identify(port))
        assert reset_emergency_stop(rig.model_copy(update={"sensor": elsewhere}), port)
        assert read_stop(port) is None


@pytest.mark.parametrize("welded", [True, pytest.param(False, marks=pytest.mark.stress)])
def test_after_the_guardian_died_the_program_measures(tmp_path, welded):
    with bench(tmp_path) as (virtual, path), Guardian(Rig.load(path)) as bank:
        expected = "current flows in channel 2" if welded else f"the guardian died; {OPEN}; {ONLY_2}"
        with pytest.raises(Exception, match=expected) as told, bank.armed():
            bank.heat(time.monotonic() + 0.3, {2: 4.0})
            bank.wait_until(time.monotonic() + 1.0)
            if welded:
                virtual.emulator.faults.welded.add(2)
            os.kill(bank.process, signal.SIGKILL)
            bank.wait_until(time.monotonic() + 2.0)
        assert isinstance(told.value, CurrentFlowsError) is welded
        assert "the guardian died" in str(told.value)


def proof_after(path: Path, heated: dict[int, float]) -> str:
    """What Ctrl-C is told after these springs were heated through a real guardian."""
    with pytest.raises(KeyboardInterrupt) as stopped, Guardian(Rig.load(path)) as bank, bank.armed():
        start = time.monotonic() + 0.3
        bank.heat(start, heated)
        bank.wait_until(start + 1.2)
        raise KeyboardInterrupt
    [proof] = stopped.value.__notes__
    return proof


def test_a_sensor_that_never_saw_the_supply_proves_nothing(tmp_path):
    """Such as that of another rig: its channels carry nothing, whatever this board does."""
    with bench(tmp_path) as (virtual, path):
        virtual.springs.has_supply = False  # of the circuit that the sensor measures
        proof = proof_after(path, {1: 3.0, 3: 3.0})
    assert proof == (
        f"{OPEN}; the sensor shows no current in channels 1 to 4, but it has not measured the supply in this "
        "run, so this proves nothing"
    )


def test_a_welded_contact_that_the_sensor_does_not_measure_is_left_open_in_words(tmp_path):
    with bench(tmp_path, inputs=[1]) as (virtual, path):
        weld(virtual, 3)
        proof = proof_after(path, {1: 3.0, 3: 3.0})
        assert virtual.emulator.contacts[2], "it stays closed, and the board does not know"
    assert proof == (
        f"{OPEN}; no current flows in channel 1 by the sensor (it measured the supply in it in this run); "
        "nothing measures channels 2 to 4"
    )


def test_what_an_earlier_run_saw_proves_nothing_of_the_next(tmp_path):
    """One guardian, two runs; the supply is off in the second."""
    with bench(tmp_path) as (virtual, path), Guardian(Rig.load(path)) as bank:
        with bank.armed():
            bank.heat(time.monotonic() + 0.3, {2: 1.0})
            bank.wait_until(time.monotonic() + 1.6)
        virtual.springs.has_supply = False
        with (
            pytest.raises(EldirError, match=f"the guardian died; {OPEN}; .*channels 1 to 4, but it"),
            bank.armed(),
        ):
            os.kill(bank.process, signal.SIGKILL)
            bank.wait_until(time.monotonic() + 2.0)


def test_a_sensor_that_fails_at_the_start_leaves_no_stop(tmp_path):
    """Nothing was heated, and the board reported everything open."""
    with bench(tmp_path) as (virtual, path):
        with Guardian(Rig.load(path)) as bank:
            virtual.emulated_sensor.faults.silent = True
            with pytest.raises(SensorError, match="did not answer"):
                bank.arm()
        assert read_stop(virtual.emulator.port) is None
        virtual.emulated_sensor.faults.silent = False
        with Guardian(Rig.load(path)) as bank, bank.armed():
            pass
