"""The limits and the wiring of this MOSFET board. No command changes them: only a new copy of this file does.

`eldir rig firmware --rig rig.yaml --out folder` writes this file with the limits of a rig file.
"""

PINS = (0, 1, 2, 3, 4, 5, 6, 7)
"""Number of the GPIO at the gate of each channel, channel 1 first."""

MAX_ON_MS = 6200
"""Longest time at full power, from cold. Longer than the rig file's `max_on_s` by 0.1 s at least [ms]."""

DUTY_PERCENT = 50
"""Largest mean power, as a part of the full power [%]. Not smaller than the rig file's `duty`."""

STEADY = ()
"""Channels without these two limits, because they heat nothing, such as a fan's: numbers from 1."""

HEARTBEAT_MS = 400
"""Everything goes off after this time without a valid frame [ms]."""

WATCHDOG_MS = 250
"""The chip resets when the program has hung for this time [ms]; 8388 at most on the RP2040."""

PERIOD_MS = 100
"""Period of the pulse-width modulation [ms]."""

SERVICE_PIN = 22
"""GPIO that keeps the firmware from starting while it is connected to ground, so that files can be
changed."""
