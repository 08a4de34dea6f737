"""The air before a run: files as Linux writes them for a DS18B20, what a person enters, and both."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from eldir.errors import EldirError, InputError
from eldir_app.doctor import examine
from eldir_hardware.log.reader import read_log
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError, worst_springs
from eldir_hardware.run.drive import to_dry_run
from eldir_hardware.run.room import measure_room, with_room
from eldir_hardware.thermometer import ThermometerError, read_thermometer
from eldir_hardware.virtual.rig import room_temperature, thermometer_reading
from tests.hardware.emulated_rigs import rig_values, run
from tests.hardware.rigs_and_schedules import SCHEDULE, rig_text, rig_with
from tests.raised import raises


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """As the kernel's, in a folder of the bus."""
    path = tmp_path / "28-0316a279b5ff" / "temperature"
    path.parent.mkdir()
    path.write_text("21437\n")
    return path


def real_rig(file: Path) -> Rig:
    return Rig.from_json(rig_values("lcus", "/dev/none", thermometer={"kind": "w1", "path": str(file)}))


def test_it_is_read_in_thousandths_of_a_degree(file: Path) -> None:
    assert read_thermometer(file) == 21.437
    file.write_text("-5062\n")
    assert read_thermometer(file) == -5.062
    assert measure_room(rig_with()).room_c is None and not measure_room(rig_with()).text


@pytest.mark.parametrize(
    ("text", "code", "match"),
    [
        ("85000\n", "thermometer.not-measured", "found 85 C, its value after power-on; check its supply"),
        ("127937\n", "thermometer.implausible", "expected -20 to 60 C; found 127.937 C"),
        ("-20001\n", "thermometer.implausible", "found -20.001 C"),
        ("", "thermometer.unreadable", "found '' instead of"),  # the kernel's answer without a sensor
        ("21.4\n", "thermometer.unreadable", "found '21.4' instead of"),
        ("4a 01 4b 46 7f ff 0c 10 22 : crc=22 YES", "thermometer.unreadable", "'4a 01 4b 46 7f ff 0c"),
    ],
)
def test_what_is_no_temperature_of_a_room_is_refused(file: Path, text: str, code: str, match: str) -> None:
    file.write_text(text)
    with raises(ThermometerError, code, match=match):
        measure_room(real_rig(file))


def test_a_thermometer_that_is_not_there_is_refused(file: Path) -> None:
    for path in (file.parent.parent / "28-none" / "temperature", file.parent, Path("/dev/null")):
        with raises(ThermometerError, "thermometer.unreadable", match="ls /sys/bus/w1/devices"):
            read_thermometer(path)


def test_a_file_that_nobody_writes_any_more_is_refused(file: Path) -> None:
    os.utime(file, (0, time.time() - 50))
    assert read_thermometer(file) == 21.437
    os.utime(file, (0, time.time() - 70))
    with raises(ThermometerError, "thermometer.stale", match="written 70 s ago"):
        read_thermometer(file)
    kernel = Path("/sys/class/net/lo/mtu")  # the kernel's own files have no time of writing
    if kernel.exists() and time.time() - kernel.stat().st_mtime > 60:
        with raises(ThermometerError, "thermometer.implausible"):
            read_thermometer(kernel)


def test_what_a_person_enters_takes_precedence(file: Path) -> None:
    rig = real_rig(file)
    assert measure_room(rig) == (21.437, "the thermometer shows 21.4 C", False)
    assert measure_room(rig, 23.4) == (23.4, "the air was measured before the run: 23.4 C", False)
    found = measure_room(rig, 23.5)
    assert found.room_c == 23.5 and found.is_doubtful
    assert found.text.endswith("23.5 C, but the thermometer shows 21.4 C: 23.5 C is used")
    file.unlink()
    found = measure_room(rig, 23.5)
    assert found.room_c == 23.5 and found.is_doubtful and "cannot read the thermometer" in found.text


def test_air_outside_of_the_tolerances_is_refused_whoever_measured_it(file: Path) -> None:
    file.write_text("30062\n")
    for entered in (None, 17.9, float("nan")):
        with raises(LimitError, "limit.room"):
            measure_room(real_rig(file), entered)


def test_a_rig_in_its_room_has_the_same_limits(file: Path) -> None:
    rig = real_rig(file)
    warm = with_room(rig, 29.5)
    assert warm.spring_parameters().ambient == 29.5 and rig.spring_parameters().ambient == 22
    assert worst_springs(warm) == worst_springs(rig) and with_room(rig, None) is rig
    assert Rig.from_json(warm.to_json()) == warm, "as the guardian gets it"


def test_a_real_thermometer_needs_its_file() -> None:
    with pytest.raises(InputError, match=r"a real thermometer needs its file: thermometer\.path"):
        Rig.from_json(rig_values("lcus", "/dev/none", thermometer={"kind": "w1"}))
    for wrong in ({"kind": "w1", "path": "28-1/temperature"}, {"kind": "ds18b20"}):
        with pytest.raises(EldirError, match="thermometer"):
            rig_with(thermometer=wrong)


def test_that_of_a_virtual_rig_has_its_error() -> None:
    rigs = [rig_with(virtual={"seed": seed}) for seed in range(12)]
    errors = np.array([thermometer_reading(rig) - room_temperature(rig) for rig in rigs])
    assert 0.3 < np.abs(errors).max() < 0.5 + 1 / 32 and (errors > 0).any() and (errors < 0).any()
    assert all(thermometer_reading(rig) * 16 % 1 == 0 for rig in rigs)
    rig = rig_with(thermometer={"kind": "w1"})
    assert measure_room(rig).room_c == thermometer_reading(rig)


def test_the_doctor_reads_it(file: Path) -> None:
    def finding() -> tuple[bool, str]:
        (found,) = [f for f in examine(real_rig(file), file.parent) if f.subject == "thermometer"]
        return found.ok, found.text

    assert finding() == (True, "the air has 21.4 C, within the tolerances")
    file.write_text("31000\n")
    assert not finding()[0] and "outside of the rig file's tolerances; expected 18 to 30 C" in finding()[1]
    file.write_text("85000\n")
    assert not finding()[0] and "85 C, its value after power-on" in finding()[1]
    assert to_dry_run(real_rig(file)).thermometer.path is None, "it emulates the thermometer too"


def test_drive_reads_it_and_keeps_it_in_the_log(tmp_path: Path) -> None:
    """The virtual rig's own; and that it and a person disagree stands on the screen and in the log."""
    values = yaml.safe_load(rig_text()) | {"thermometer": {"kind": "w1"}}
    del values["camera"]
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(values))
    schedule = tmp_path / "schedule.json"
    SCHEDULE.save(schedule)
    shown = thermometer_reading(Rig.load(rig))
    drive = ("drive", schedule, "--rig", rig, "--accept-mismatch", "a test", "--log")
    assert f"note: the thermometer shows {shown:.1f} C" in run(*drive, tmp_path / "a.mcap").output
    log = read_log(tmp_path / "a.mcap")
    assert log.room_c == pytest.approx(shown, abs=0.01)
    assert ("room", f"the thermometer shows {shown:.1f} C") in [status[1:] for status in log.statuses]
    assert log.temperatures[0] == pytest.approx(shown, abs=1e-3), "the model begins at the measured air"
    entered = shown - 2.5
    output = run(*drive, tmp_path / "b.mcap", "--room", entered).output
    assert f"warning: the air was measured before the run: {entered:g} C, but the thermometer" in output
    log = read_log(tmp_path / "b.mcap")
    assert log.room_c == pytest.approx(entered, abs=0.01)
    assert any(f"shows {shown:.1f} C: {entered:g} C is used" in text for _, _, text in log.statuses)
