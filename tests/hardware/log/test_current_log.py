"""Measured currents in the log, in the doctor's findings, and as readings of a meter."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from eldir.errors import EldirError
from eldir_app.doctor import examine
from eldir_calibration.comparison.meters import read_meters
from eldir_hardware.clock import WallClock
from eldir_hardware.current_sensor import CHIPS
from eldir_hardware.emulator.current_sensor import EmulatedCurrentSensor
from eldir_hardware.guardian.measured_heat import CurrentFlowsError, require_no_current
from eldir_hardware.log.reader import RunLog, read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_emulator
from eldir_hardware.run.drive import drive_rig, to_dry_run
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.virtual import rig as virtual_module
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.emulated_rigs import rig_file, run
from tests.hardware.rigs_and_schedules import gait, rig_text

MEASURED_WELL = {
    "supply": {"voltage_v": 11, "current_limit_a": 4, "max_total_current_a": 20},
    "tolerances": {"current": 0.01, "ambient_max_c": 22, "convection_tolerance": 0.02},
}
"""So that pulses of 5.5 s at 4 A are allowed, which make the springs hot."""


def driven(folder: Path, **entries: object) -> tuple[RunLog, Rig, Path]:
    """A short schedule on a virtual rig without a camera."""
    folder.mkdir(exist_ok=True)
    values = yaml.safe_load(rig_text()) | entries
    del values["camera"]
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(values))
    rig = Rig.load(path)
    schedule = replace(compile_schedule(gait(), rig, (0, 1), cycles=1), settle_s=1.0, conditioning_cycles=0)
    drive_rig(with_digests(schedule, rig), rig, path, folder / "log.mcap")
    return read_log(folder / "log.mcap"), rig, folder / "log.mcap"


def test_currents_come_back_from_a_log(tmp_path):
    """With the contacts' reports, as standard messages; nothing where no input measures."""
    log, rig, path = driven(tmp_path / "a", sensor={"kind": "ina226", "channels": [1, 2, 4]})
    assert log.currents.shape == log.voltages.shape == (len(log.current_times), 4)
    assert set(log.current_times) <= set(log.relay_times)
    assert len(log.current_times) > 0.9 * len(log.relay_times), "hardly one is left out for a switching"
    assert np.isnan(log.currents[:, 2]).all() and np.isfinite(log.currents[:, [0, 1, 3]]).all()
    assert any(part == "heat model" and "channels 1, 2, 4" in text for _, part, text in log.statuses)
    limit = rig.supply.current_limit_a
    closed = log.relays[np.searchsorted(log.relay_times, log.current_times)]
    for column in (0, 1, 3):
        on = closed[:, column]
        assert on.any() and log.currents[on, column] == pytest.approx(limit, rel=0.02)
        assert np.abs(log.currents[~on, column]).max() < 0.01
        assert log.voltages[on, column] == pytest.approx(limit * 0.987, rel=0.06)
    found = read_meters([(log, rig)], hot=False)
    assert found.partial == " in 3 of 4 springs", "the contact of the fourth one was closed, too"
    sensor = found.current_error / np.sqrt(3)
    assert found.error == pytest.approx(np.hypot(sensor, 0.25 * 0.025)), "5 % are two deviations"
    with AnyReader([path]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
    assert kinds["/currents"] == kinds["/voltages"] == "control_msgs/msg/DynamicJointState"
    assert driven(tmp_path / "b", sensor={"kind": "ina226", "channels": [1, 2, 4]})[2].read_bytes() == (
        path.read_bytes()
    )


def test_a_log_without_a_sensor_holds_no_currents(tmp_path):
    log, _, path = driven(tmp_path)
    assert log.currents.shape == log.voltages.shape == (0, 0) and not len(log.current_times)
    assert not any(part == "heat model" for _, part, _ in log.statuses)
    with AnyReader([path]) as reader:
        assert not {"/currents", "/voltages"} & {c.topic for c in reader.connections}


def test_springs_without_names_are_numbered(tmp_path):
    with Recorder(tmp_path / "log.mcap") as recorder:
        recorder.on_temperatures(0.0, (20.0, 30.0))
        recorder.on_currents(0.0, (1.5, float("nan")), (2.5, 3.5))
    log = read_log(tmp_path / "log.mcap")
    assert log.springs == ("spring0", "spring1") and log.voltages.tolist() == [[2.5, 3.5]]
    assert log.currents[0, 0] == 1.5 and np.isnan(log.currents[0, 1])


def test_the_log_holds_the_measurement_that_ended_the_run(tmp_path, monkeypatch):
    opened = virtual_module.VirtualRig.open

    def open_broken(rig: VirtualRig) -> None:
        opened(rig)
        rig.springs.break_lead(3)

    monkeypatch.setattr(virtual_module.VirtualRig, "open", open_broken)
    with pytest.raises(EldirError, match="no current flows in channel 3 although its contact was closed"):
        driven(tmp_path, sensor={"kind": "ina3221"})
    log = read_log(tmp_path / "log.mcap")
    assert "no current flows in channel 3" in log.statuses[-1][2]
    assert log.relays[-1, 2] and abs(log.currents[-1, 2]) < 0.05 and log.voltages[-1, 2] > 10


def test_a_dry_run_emulates_the_sensor_too():
    rig = Rig.from_json(yaml.safe_load(rig_text()) | {"sensor": {"kind": "ina226", "port": "/dev/x"}})
    assert to_dry_run(rig).sensor == rig.sensor.model_copy(update={"port": None})


@pytest.mark.parametrize("kind", CHIPS)
def test_readings_are_those_of_the_hidden_springs(tmp_path, kind):
    """Their mean current and voltage while hot, within three of the standard deviations that are given."""
    sensor = {"kind": kind, "lead_ohm": 0.03}
    log, rig, _ = driven(tmp_path, sensor=sensor, virtual={"seed": 7}, **MEASURED_WELL)
    found = read_meters([(log, rig)], hot=True)
    with VirtualRig(rig, SimpleNamespace()) as virtual:
        springs = virtual.springs.parameters
    amperes = np.mean([s.current(0.0) for s in springs])
    volts = np.mean([s.current(0.0) * s.resistance_at(0.0) for s in springs])
    assert found.current_a == pytest.approx(amperes, rel=3 * found.error)
    assert found.voltage_v == pytest.approx(volts, rel=3 * found.error)
    assert volts != pytest.approx(rig.supply.current_limit_a * 0.987, rel=0.002), (
        "the springs are not the nominal ones"
    )
    assert not found.partial and found.spring_error == found.current_error, "the sensor explains the spread"
    assert found.pulses == 4 and 0.006 < found.error < 0.012
    shared = rig.model_copy(update={"supply": rig.supply.model_copy(update={"outputs": "shared"})})
    assert read_meters([(log, shared)], hot=True) is None, "two faces heat together"
    late = rig.model_copy(update={"springs": rig.springs.model_copy(update={"austenite_start_c": 59.9})})
    barely = replace(log, temperatures=np.minimum(log.temperatures, 58.0))
    assert read_meters([(barely, rig)], hot=True) is not None
    assert read_meters([(barely, late)], hot=True) is None, "all of it is still martensite"
    cold = replace(log, temperatures=log.temperatures - 40)
    assert read_meters([(cold, rig)], hot=True) is None
    warming = read_meters([(cold, rig)], hot=False)
    assert warming is not None and warming.pulses == found.pulses
    assert warming.current_a == pytest.approx(amperes, rel=warming.current_error)
    off = replace(log, currents=0.0005 * log.currents)
    assert read_meters([(off, rig)], hot=False) is None, "a rehearsal with the supply switched off"
    assert read_meters([(log, rig.model_copy(update={"sensor": None}))], hot=True) is None


@pytest.fixture
def bench(tmp_path):
    """An emulated board and an emulated sensor, whose currents `flowing` sets, in a rig file of kind real."""
    flowing: dict[int, float] = {}
    board = get_emulator("lcus")(4, WallClock())

    def circuit(channel: int, t: float) -> tuple[float, float]:
        return flowing.get(channel, 0.0), flowing.get(channel, 0.0)

    sensor = EmulatedCurrentSensor("ina226", (1, 2, 3, 4), circuit, WallClock())
    entry = {"kind": "ina226", "port": sensor.start()}
    path = rig_file(tmp_path / "rig.yaml", "lcus", board.start(), sensor=entry)
    yield path, flowing, sensor
    sensor.close()
    board.close()


def finding(path: Path):
    (found,) = [f for f in examine(Rig.load(path), path.parent) if f.subject == "current sensor"]
    return found


def test_the_doctor_asks_the_sensor(bench):
    path, flowing, sensor = bench
    found = finding(path)
    assert found.ok and "the sensor shows no current in channels 1 to 4 (at most" in found.text
    flowing[3] = 2.0
    assert "FAIL  current sensor: current flows in channel 3" in run("doctor", "--rig", path).output
    flowing.clear()
    sensor.faults.silent = True
    assert not finding(path).ok and "did not answer" in finding(path).text
    text = path.read_text()
    path.write_text(text.replace(sensor.port, "/dev/no-such-port"))
    assert not finding(path).ok and "No such file" in finding(path).text


def test_the_doctor_names_channels_that_nothing_measures(bench):
    path, _, _ = bench
    values = yaml.safe_load(path.read_text())
    values["sensor"]["channels"] = [1, 3]
    path.write_text(yaml.safe_dump(values))
    assert not finding(path).ok and finding(path).text.endswith("nothing measures channels 2, 4: add inputs")


def test_whoever_opened_all_contacts_can_ask(bench):
    """As `eldir rig off` and `eldir rig reset` may, which own no controller."""
    path, flowing, _ = bench
    rig = Rig.load(path)
    assert require_no_current(rig).startswith("the sensor shows no current in channels 1 to 4 (at most ")
    flowing[1] = 4.0
    with pytest.raises(
        CurrentFlowsError, match=r"channel 1 although its contact was opened.*cut the heating"
    ):
        require_no_current(rig)
    assert require_no_current(rig.model_copy(update={"sensor": None})) is None
