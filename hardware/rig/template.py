"""A commented rig file to start from."""

from __future__ import annotations

import re
from contextlib import suppress

import yaml

from eldir.core.yaml_files import parse_yaml
from eldir.errors import InputError
from eldir.parameters.wiring import wiring
from hardware.relay.registration import board_of

MOTORS = 2
"""A robot that can be built has one or two (docs/reference/packet.md)."""
CURRENT_LIMIT_A = 3.45
"""What a rig like the virtual one may have, rounded down to a twentieth: with it, springs of 0.75 mm wire
with the fan, pulses of 6 s and a cut-off of 6.3 s stay below the ceiling in the worst corner of the
tolerances (decision 31). Springs of which no rig is known, `SpringParameters`, have 4 A instead."""
_HEAD = """\
# A rig for eldir. What each entry means: docs/reference/rig.md. Read docs/safety.md before you connect heat.
format: eldir-rig/1
name: {name}
kind: {kind}

board:
  kind: {board}  # the protocol is never guessed: the same byte means on to one board and off to another
{port}  channels: {count}
  contact_rating_a: 10
{flash}
# Which relay channel heats which spring: active springs are numbered from 0 in the design's spring order,
# and each is there twice, on the front and the back plane. The packet's wiring.csv says the same.
# If you wired otherwise, write it here. To see which spring grows warm: eldir rig doctor --wiring.
channels:
{channels}
"""
_REAL = """
# One current-limited output for each channel. The rig does not arm before both nulls are measured values.
supply:
  voltage_v: 11
  current_limit_a: null  # of each output
  budget_a: 16           # of all together
  lead_resistance_ohm: 0.05
springs:
  resistance_ohm: null   # of one spring at room temperature
  ambient_c: 22

# How far current, air temperature and cooling may be from the values here. Limits hold in the worst corner:
# with the fan and a timer of 6.3 s, springs of 0.75 mm wire allow CURRENT A.
tolerances: {current: 0.05, coldest_c: 18, hottest_c: 30, air_stream: 0.1}

# Uncomment what is there. The fan counts only if its failure cuts the heating supply.
# fan: {interlocked: true}

# Needed unless the current limit is so small that a spring held on for ever stays below the ceiling.
# cutoff: {kind: timer, longest_on_s: 6.3}  # in series with each channel, not driven by this computer

# Current and voltage of each channel, measured: docs/reference/sensor.md.
# sensor: {kind: ina226, port: /dev/serial/by-path/..., shunt_ohm: 0.01}

limits: {ceiling_c: 90, longest_on_s: 6.0, least_off_s: 8.0}

# What films the robot while it is driven; plane.json comes from eldir calibrate plane.
# camera: {kind: live, device: camera:0, rate_hz: 30, width: 640, height: 480, plane: plane.json}

# Markers on m1 to m5: discs, or squares where colours cannot be used (aruco, apriltag). Print: eldir markers.
# marker: discs

# Who gets a word when a run has ended or stopped, or its camera is lost (pip install 'eldir[notify]').
# notify: ["mailto://user:password@example.org"]
"""
_VIRTUAL = """
supply: {{voltage_v: 11, current_limit_a: {current}, budget_a: 16, lead_resistance_ohm: 0.05}}
springs: {{resistance_ohm: 0.987, ambient_c: 22}}
tolerances: {{current: 0.05, coldest_c: 18, hottest_c: 30, air_stream: 0.1}}
fan: {{interlocked: true}}
# Held on, a spring would pass the ceiling: each channel has an emulated timer relay in series.
cutoff: {{kind: timer, longest_on_s: 6.3}}
limits: {{ceiling_c: 90, longest_on_s: 6.0, least_off_s: 8.0}}
camera: {{kind: virtual, rate_hz: 10}}

virtual:
  seed: {seed}           # how springs, body and camera differ from the nominal ones
  clock: {clock}    # virtual: as fast as it goes; wall: in real time
  physics: {physics}      # what moves the robot: eldir, or mujoco (pip install 'eldir[mujoco]')
{design}"""


def real_rig(board: str, port: str) -> str:
    """The text of a rig file for a real board; it arms only when completed."""
    head = _head("bench", "real", board, f"  port: {_scalar(port)}\n", "null")
    return head + _REAL.replace("CURRENT", f"{CURRENT_LIMIT_A:g}")


def virtual_rig(
    seed: int = 1,
    design: str | None = None,
    board: str = "lcus",
    clock: str = "virtual",
    physics: str = "eldir",
) -> str:
    """The text of a complete virtual rig file; `design` is a path relative to that file."""
    head = _head("virtual bench", "virtual", board, "", "restarts")
    robot = "" if design is None else f"  design: {_scalar(design)}\n"
    return head + _VIRTUAL.format(
        current=CURRENT_LIMIT_A, seed=seed, clock=clock, physics=physics, design=robot
    )


def _scalar(text: str) -> str:
    """A text as YAML: as it is where it is one plain word that is read back the same, otherwise quoted."""
    if not re.search(r"[\s,{}\[\]]", text):
        with suppress(InputError):
            if parse_yaml(f"name: {text}\n".encode(errors="replace"), "") == {"name": text}:
                return text
    style = "'" if text.isprintable() else '"'
    return yaml.safe_dump(text, default_style=style, allow_unicode=True, width=1 << 20).strip()


def _head(name: str, kind: str, board: str, port: str, second_flash: str) -> str:
    connections = wiring(MOTORS)
    rows = [f"  - {{channel: {c.channel}, spring: {c.spring}, face: {c.face}}}" for c in connections]
    return _HEAD.format(
        name=name,
        kind=kind,
        board=board,
        port=port,
        count=len(connections),
        flash=_flash(board, second_flash),
        channels="\n".join(rows),
    )


def _flash(board: str, value: str) -> str:
    driver = board_of(board).driver
    if not driver.times_pulses or driver.second_flash is not None:
        return ""
    return f"  second_flash: {value}  # restarts | ignored: measured by eldir rig doctor --pulses\n"
