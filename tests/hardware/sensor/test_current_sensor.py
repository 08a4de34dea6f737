"""The current sensor: the microcontroller's program on emulated chips, its line protocol, and its driver."""

import ast
import os
import re
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldir.errors import InputError
from eldir_hardware import firmware
from eldir_hardware.clock import VirtualClock, WallClock
from eldir_hardware.current_sensor import CHIPS, CurrentSensor, SensorError, make_request, parse_line
from eldir_hardware.emulator.current_sensor import (
    EmulatedCurrentSensor,
    EmulatedI2c,
    EmulatedIna226,
    EmulatedIna3221,
    MicrocontrollerClock,
    Shunts,
)
from eldir_hardware.firmware import current_sensor as program
from eldir_hardware.rig.configuration import Rig
from tests.hardware.rigs_and_schedules import rig_with
from tests.paths import ROOT

CHANNELS = (1, 2, 3, 4)


def flows(channel, t):
    """Channel n carries n amperes through 0.9 ohms."""
    return float(channel), 0.9 * channel


@pytest.fixture
def opened():
    """Opens an emulated sensor with its driver; both are closed at the end."""
    found = []

    def open_one(kind="ina3221", channels=CHANNELS, circuit=flows, clock=None, named=None, **options):
        clock = clock or VirtualClock()
        emulated = EmulatedCurrentSensor(kind, channels, circuit, clock, **options)
        found.append(emulated)
        port = emulated.start()
        driver = CurrentSensor(port, named or kind, channels, clock)
        found.append(driver)
        return emulated, driver, clock

    yield open_one
    for one in reversed(found):
        one.close()


@pytest.mark.parametrize("kind", CHIPS)
@pytest.mark.parametrize("seed", range(5))
def test_it_measures_within_the_errors_that_its_data_sheet_allows(opened, kind, seed):
    """Offset, gain and shunt of the emulated chips lie anywhere within their tolerance."""
    _, driver, _ = opened(kind, seed=seed)
    measured = driver.measure()
    chip = CHIPS[kind]
    for channel in CHANNELS:
        amperes, volts = flows(channel, 0.0)
        error = chip.current_error(0.01, 0.01, amperes)
        assert measured.currents[channel] == pytest.approx(amperes, abs=error)
        assert measured.voltages[channel] == pytest.approx(volts, abs=chip.voltage_error(volts))
    assert measured.saturated == frozenset()


@pytest.mark.parametrize("kind", CHIPS)
def test_no_current_is_told_from_the_smallest(opened, kind):
    zero = CHIPS[kind].zero_current(0.01)
    for amperes in (0.0, 1.5 * zero):
        for seed in range(5):
            _, driver, _ = opened(kind, circuit=lambda channel, t, a=amperes: (a, a), seed=seed)
            measured = driver.measure()
            assert all((abs(i) > zero) == (amperes > 0) for i in measured.currents.values())


def test_a_measurement_is_younger_than_its_question(opened):
    """A current that ended as the question was sent is not in the answer, not even in an average."""
    end = []
    _, driver, clock = opened(circuit=lambda channel, t: (4.0, 4.0) if t < end[0] else (0.0, 0.0))
    for _ in range(10):
        end[:] = [clock.now()]
        measured = driver.measure()
        assert measured.started_at >= end[0] and max(map(abs, measured.currents.values())) < 0.03
        clock.sleep_until(clock.now() + 0.0137)


def test_leads_to_the_spring_are_taken_off_the_voltage():
    clock = VirtualClock()
    emulated = EmulatedCurrentSensor("ina226", (1,), flows, clock, Shunts(tolerance=0.0, lead=0.1))
    driver = CurrentSensor(emulated.start(), "ina226", (1,), clock, lead=0.1)
    assert driver.measure().voltages[1] == pytest.approx(0.9, abs=0.012)
    driver.close(), emulated.close()


def test_a_saturated_shunt_is_named(opened):
    _, driver, _ = opened("ina226", circuit=lambda channel, t: (9.0 if channel == 2 else 1.0, 1.0))
    assert driver.measure().saturated == {2}
    assert driver.measure().currents[2] == pytest.approx(CHIPS["ina226"].full_scale_current(0.01))


@pytest.mark.parametrize("kind", CHIPS)
def test_a_question_takes_as_long_as_it_says(opened, kind):
    """In virtual time, where only the protocol counts; the guardian keeps so much away from a switching."""
    _, driver, clock = opened(kind)
    for _ in range(3):
        begun = clock.now()
        driver.measure()
        assert clock.now() - begun <= driver.query_time < 0.03


FAULTS = {
    "silent": (lambda s: setattr(s.faults, "silent", True), "did not answer"),
    "late": (lambda s: setattr(s.faults, "late", 5.0), "did not answer"),
    "garbled": (lambda s: setattr(s.faults, "garbled", True), "invalid answer|did not answer"),
    "chip lost": (lambda s: setattr(s.i2c.chips[0x41].faults, "missing", True), "0x41 does not answer"),
    "chip stuck": (lambda s: setattr(s.i2c.chips[0x40].faults, "stuck", True), "0x40 does not finish"),
    "unplugged": (lambda s: s.unplug(), "was lost|did not answer"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_named_and_nothing_waits_for_long(opened, name):
    """At most the patience of the clock twice, on a machine that is busy: a second on the wall."""
    clock = WallClock()
    emulated, driver, _ = opened(clock=clock)
    driver.measure()
    strike, message = FAULTS[name]
    strike(emulated)
    begun = clock.now()
    with pytest.raises(SensorError, match=message):
        driver.measure()
    assert clock.now() - begun < 1.0


def test_one_damaged_answer_is_asked_for_again(opened):
    emulated, driver, _ = opened()
    deliver, damaged = emulated.deliver, [True, False]

    def deliver_damaged(answer: bytes) -> None:
        deliver(answer.replace(b"M", b"m") if damaged.pop(0) else answer)

    emulated.deliver = deliver_damaged
    assert driver.measure().currents[4] == pytest.approx(4.0, rel=0.02)
    assert not damaged


def test_a_microcontroller_that_lost_chips_at_a_restart_is_noticed(opened):
    emulated, driver, _ = opened()
    emulated._program.chips.pop()
    with pytest.raises(SensorError, match=r"invalid answer .*found 3 inputs instead of 6"):
        driver.measure()


def test_an_answer_that_comes_late_is_not_taken_for_the_next_one(opened):
    clock = WallClock()
    emulated, driver, _ = opened(clock=clock)
    emulated.faults.late = 0.35  # longer than the driver waits
    with pytest.raises(SensorError, match="did not answer"):
        driver.measure()
    emulated.faults.late = 0.0
    stop = threading.Event()

    def old_answers() -> None:
        while not stop.wait(0.002):
            emulated.deliver(program.with_crc("M 00 9,9 9,9 9,9 9,9 0,0 0,0"))

    thread = threading.Thread(target=old_answers)
    thread.start()
    try:
        assert driver.measure().currents[4] == pytest.approx(4.0, rel=0.02)
    finally:
        stop.set()
        thread.join()


def test_other_chips_than_the_rig_file_says():
    clock = VirtualClock()
    for kind, named, channels, message in (
        ("ina226", "ina3221", (1,), "chips differ from those of the rig file; expected ina3221"),
        ("ina3221", "ina3221", (1, 2, 3, 4), "too few channels; expected 4.*found chips with 3 inputs"),
        ("ina226", "ina226", (1,), "too few channels; expected 1.*found chips with 0 inputs"),
    ):
        emulated = EmulatedCurrentSensor(kind, channels[:3], flows, clock)
        emulated.i2c.chips[0x40].faults.missing = message.endswith("0 inputs")
        port = emulated.start()
        with pytest.raises(SensorError, match=message):
            CurrentSensor(port, named, channels, clock)
        emulated.close()
    with pytest.raises(SensorError, match=r"cannot open.*sensor\.port"):
        CurrentSensor("/dev/no-such-port", "ina226", (1,), clock)


def microcontroller() -> program.CurrentSensor:
    time = MicrocontrollerClock(VirtualClock())
    rng = np.random.default_rng(3)
    chip = EmulatedIna3221([lambda t: (1.0, 2.0)] * 3, time, [0.01] * 3, rng)
    found = program.CurrentSensor(EmulatedI2c(time, {0x40: chip}))
    found.identify()
    return found


@given(st.binary(max_size=60))
def test_noise_is_no_question(noise):
    """An answer needs a sound check sum, which 16 bits let noise have once in 65536."""
    answer = microcontroller().answer(noise + b"\n")
    assert answer == b"" or parse_line(noise) is not None


@given(st.integers(0, 255), st.data())
def test_a_flipped_bit_is_noticed_on_both_ways(sequence, data):
    sensor = microcontroller()
    answer = sensor.answer(make_request("M", sequence))
    assert parse_line(answer)[:2] == ["M", f"{sequence:02X}"] and len(parse_line(answer)) == 5
    for line, taken in ((make_request("M", sequence), sensor.answer), (answer, parse_line)):
        body = line[:-1]
        bit = data.draw(st.integers(0, 8 * len(body) - 1))
        damaged = bytearray(body)
        damaged[bit // 8] ^= 1 << bit % 8
        assert not taken(bytes(damaged) + b"\n")


def test_the_registers_are_those_of_the_data_sheets():
    """Power-on values, identities, and a count of each register (SBOS547B, SBOS576A)."""
    time, rng = MicrocontrollerClock(VirtualClock()), np.random.default_rng(1)
    one = EmulatedIna226([lambda t: (4.0, 4.0)], time, [0.01], rng)
    three = EmulatedIna3221([lambda t: (4.0, 4.0)] * 3, time, [0.01] * 3, rng)
    for chip, power_on, die in ((one, 0x4127, 0x2260), (three, 0x7127, 0x3220)):
        assert (chip.read(0), chip.read(0xFE), chip.read(0xFF)) == (power_on, 0x5449, die)
    time.wait(0.01)
    assert one.read(1) == pytest.approx(0.04 / 2.5e-6, rel=2e-3)
    assert one.read(2) == pytest.approx(4.0 / 1.25e-3, abs=10)
    assert three.read(1) % 8 == 0 and three.read(1) / 8 == pytest.approx(0.04 / 40e-6, abs=6)
    assert three.read(6) / 8 == pytest.approx(4.0 / 8e-3, abs=5)
    assert one.read(6) & 8 and not one.read(6) & 8, "reading the flag clears it"
    one.write(0, program.Ina226.configuration)
    time.wait(0.0087)
    assert not one.read(6) & 8, "four averages of twice 1.1 ms take 8.8 ms"
    time.wait(0.0002)
    assert one.read(6) & 8


def test_the_program_is_one_that_micropython_runs():
    """It imports nothing that a microcontroller lacks, and uses no syntax newer than MicroPython's."""
    sources = Path(firmware.__file__).parent
    for name, imports in (("current_sensor.py", {"sys", "time", "machine", "micropython"}),):
        tree = ast.parse((sources / name).read_text(), feature_version=(3, 7))
        found = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
        found |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        assert found == imports
        assert not [n for n in ast.walk(tree) if isinstance(n, ast.AnnAssign | ast.NamedExpr)]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"shunt_ohm": 0.1}, r"shunt_ohm is too large for 3.45 A: expected at most 0.038 Ohm"),
        (
            {"kind": "ina226", "shunt_ohm": 0.1},
            r"shunt_ohm is too large for 3.45 A: expected at most 0.019 Ohm",
        ),
        ({"shunt_ohm": 0.0005}, r"shunt_ohm is too small for 3.45 A: expected at least 0.00104 Ohm"),
        ({"kind": "acs712"}, "unknown chips 'acs712': expected one of ina226, ina3221"),
        ({"channels": (1, 7)}, r"sensor\.channels: each must be one of the channels that heat"),
        ({"channels": (1, 1)}, r"sensor\.channels: each must be one of the channels that heat"),
        ({"resistance_tolerance": 0.04}, "smaller than springs.resistance_tolerance"),
    ],
)
def test_a_sensor_that_does_not_fit_its_rig(entry, message):
    with pytest.raises(InputError, match=message):
        rig_with(sensor={"kind": "ina3221"} | entry)


def test_a_real_sensor_needs_a_port_of_its_own():
    values = rig_with(sensor={"kind": "ina226"}).to_json()
    values |= {"kind": "real", "camera": None}
    values["board"]["port"] = os.devnull
    for port in (None, os.devnull):
        values["sensor"]["port"] = port
        with pytest.raises(InputError, match="needs a port of its own"):
            Rig.from_json(values)
    values["sensor"]["port"] = "/dev/ttyACM0"
    assert Rig.from_json(values).measured_channels == (1, 2, 3, 4)


def test_the_lines_in_the_documentation_have_their_check_sums():
    page = (ROOT / "docs" / "reference" / "sensor.md").read_text()
    lines = re.findall(r"`([IM] [0-9A-F]{2}\*[0-9A-F]{4})`", page)
    assert [parse_line(line.encode()) for line in lines] == [["I", "07"], ["M", "08"]]
