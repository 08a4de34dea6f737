"""The program of the MOSFET board, started by MicroPython after every reset (RP2040, RP2350).

Gates are plain outputs: after a reset of the chip they are inputs with a pull-down, so that every MOSFET is
off. On MicroPython a program that ends, also by Ctrl-C, leaves outputs as they are. So this one never ends:
after any error it pulls all gates down and waits for the watchdog to reset the chip.
"""

import os
import select
import sys
import time

import limits
import machine
import micropython
from channel_limits import POWER_UP, WATCHDOG, ChannelLimits, Modulation
from protocol import MAX_REQUEST, RequestHandler

_MAX_BYTES = 32  # bytes that are read before the gates are updated again


def serve(gates: list, watchdog: object) -> None:
    """Obey the host, and keep the limits. Never returns."""
    count, now = len(gates), time.ticks_ms()
    reason = WATCHDOG if machine.reset_cause() == machine.WDT_RESET else POWER_UP
    channels = ChannelLimits(
        count,
        limits.MAX_ON_MS,
        limits.DUTY_PERCENT,
        limits.HEARTBEAT_MS,
        limits.STEADY,
        now,
        reason,
    )
    modulation = Modulation(count, limits.PERIOD_MS, now)
    handler = RequestHandler(channels, int.from_bytes(os.urandom(2), "big"))
    incoming, outgoing = select.poll(), select.poll()
    incoming.register(sys.stdin, select.POLLIN)
    outgoing.register(sys.stdout, select.POLLOUT)
    line = b""
    while True:
        answer = b""
        for _ in range(_MAX_BYTES):
            if not incoming.poll(0):
                break
            byte = sys.stdin.buffer.read(1)
            line = (line + byte)[-MAX_REQUEST:]
            if byte == b"\n":
                answer = handler.answer(line, time.ticks_ms())
                line = b""
                break
        now = time.ticks_ms()
        channels.step(now)
        high = modulation.update(channels.power, now)
        mismatched = 0
        for i in range(count):
            level = high >> i & 1
            gates[i].value(level)
            if gates[i].value() != level:
                mismatched |= 1 << i
        handler.mismatched_gates = mismatched
        watchdog.feed()
        if answer and outgoing.poll(0):  # a host that does not read must not hold up the gates
            sys.stdout.buffer.write(answer)


def start() -> None:
    """Pull all gates down, then serve, unless the service pin is connected to ground."""
    gates = [machine.Pin(pin, machine.Pin.OUT, machine.Pin.PULL_DOWN, value=0) for pin in limits.PINS]
    if not machine.Pin(limits.SERVICE_PIN, machine.Pin.IN, machine.Pin.PULL_UP).value():
        return
    micropython.kbd_intr(-1)  # a byte 03 is noise, not Ctrl-C
    watchdog = machine.WDT(timeout=limits.WATCHDOG_MS)
    try:
        serve(gates, watchdog)
    finally:
        for gate in gates:
            gate.value(0)
        while True:
            pass


start()
