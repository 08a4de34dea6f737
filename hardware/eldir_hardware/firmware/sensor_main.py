"""Starts the current sensor on an RP2040-class board under MicroPython: copy it there as main.py.

Beside it belongs current_sensor.py. I2C 0 on pins 4 (data) and 5 (clock), 400 kHz; lines on USB.
"""

import sys
import time

import machine  # of MicroPython
import micropython  # of MicroPython
from current_sensor import LONGEST_LINE, Bus, CurrentSensor  # the file beside this one, on the board


class I2cBus(Bus):
    """The real chips."""

    def __init__(self) -> None:
        self.i2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400_000)

    def read(self, address: int, register: int) -> int:
        return int.from_bytes(self.i2c.readfrom_mem(address, register, 2), "big")

    def write(self, address: int, register: int, value: int) -> None:
        self.i2c.writeto_mem(address, register, value.to_bytes(2, "big"))

    def wait(self, milliseconds: int) -> None:
        time.sleep_ms(milliseconds)  # type: ignore[attr-defined]


def main() -> None:
    """Answer questions for ever."""
    micropython.kbd_intr(-1)  # a byte 3 in noise is no Ctrl-C
    sensor = CurrentSensor(I2cBus())
    sensor.identity()
    while True:
        answer = sensor.answer(sys.stdin.buffer.readline(LONGEST_LINE))
        if answer:
            sys.stdout.buffer.write(answer)


main()
