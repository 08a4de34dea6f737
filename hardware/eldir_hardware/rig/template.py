"""A commented rig file to start from."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from typing import Any

from eldir.core.validation import adapter
from eldir.core.yaml_files import dump_yaml, parse_yaml
from eldir.errors import InputError
from eldir.parameters.bench import CONTACT_RATING_A, MAX_ON_S, MAX_TOTAL_CURRENT_A, TIMER_S
from eldir.parameters.wiring import wiring
from eldir_hardware.relay.registration import get_board
from eldir_hardware.rig.configuration import Rig

MOTORS = 2
"""A robot that can be built has one or two (docs/reference/packet.md)."""
CURRENT_LIMIT_A = 3.6
"""What a rig like the virtual one may have, rounded down to a twentieth: with it, springs of 0.75 mm wire
with the fan, pulses of 6 s in periods of 30 s and a cut-off of 6.3 s stay below the temperature limit in the
worst corner of the tolerances (decisions 31 and 58). Springs of which no rig is known, `SpringParameters`,
have 4 A instead."""
_HEAD = """\
# A rig for eldir. Read docs/safety.md before you connect heat.
# The comment above each entry explains it; a line "# entry: value" is an example that you may uncomment.
format: eldir-rig/1
name: {name}
kind: {kind}
board:
  kind: {board}
{port}  channels: {count}
  contact_rating_a: {rating:g}
{timer}channels:
{channels}
"""
_REAL = """\
supply:
  voltage_v: 11
  current_limit_a: null
  max_total_current_a: {total}
  lead_resistance_ohm: 0.05
springs:
  resistance_ohm: null
  ambient_c: 22
tolerances: {{current: 0.05, ambient_min_c: 18, ambient_max_c: 30, convection_tolerance: 0.1}}
# fan: {{interlocked: true}}
# cutoff: {{kind: timer, max_on_s: {timer}}}
# sensor: {{kind: ina226, port: /dev/serial/by-path/..., shunt_ohm: 0.01}}
# thermometer: {{kind: w1, path: /sys/bus/w1/devices/28-.../temperature}}
limits: {{max_temperature_c: 90, max_on_s: {max_on}, min_off_s: 8.0}}
# camera: {{kind: live, device: camera:0, rate_hz: 30, width: 640, height: 480, plane: plane.json}}
# marker: discs
# notify: ["mailto://user:password@example.org"]
"""
_VIRTUAL = """\
supply: {{voltage_v: 11, current_limit_a: {current}, max_total_current_a: {total}, lead_resistance_ohm: 0.05}}
springs: {{resistance_ohm: 0.987, ambient_c: 22}}
tolerances: {{current: 0.05, ambient_min_c: 18, ambient_max_c: 30, convection_tolerance: 0.1}}
fan: {{interlocked: true}}
cutoff: {{kind: timer, max_on_s: {timer}}}
# sensor: {{kind: ina226, shunt_ohm: 0.01}}
# thermometer: {{kind: w1}}
limits: {{max_temperature_c: 90, max_on_s: {max_on}, min_off_s: 8.0}}
camera: {{kind: virtual, rate_hz: 10}}
# marker: discs
virtual:
  seed: {seed}
  clock: {clock}
  physics: {physics}
{design}# notify: ["mailto://user:password@example.org"]
"""
_BENCH = {"total": f"{MAX_TOTAL_CURRENT_A:g}", "timer": TIMER_S, "max_on": MAX_ON_S}
_WIDTH = 110  # of a comment [characters]


def real_rig(board: str, port: str, *, in_series: bool = False) -> str:
    """The text of a rig file for a real board; it arms only when completed. `in_series`: as of `wiring`."""
    head = _fill_head("bench", "real", board, f"  port: {_scalar(port)}\n", "null", in_series)
    return _with_comments(head + _REAL.format(**_BENCH), "VirtualEntry", "VirtualCameraEntry")


def virtual_rig(
    seed: int = 1,
    design: str | None = None,
    board: str = "lcus",
    clock: str = "virtual",
    physics: str = "eldir",
    *,
    in_series: bool = False,
) -> str:
    """The text of a complete virtual rig file; `design` is a path relative to that file. `in_series`: as of
    `wiring`."""
    head = _fill_head("virtual bench", "virtual", board, "", "true", in_series)
    robot = "" if design is None else f"  design: {_scalar(design)}\n"
    text = _VIRTUAL.format(
        current=CURRENT_LIMIT_A, seed=seed, clock=clock, physics=physics, design=robot, **_BENCH
    )
    return _with_comments(head + text, "LiveCameraEntry")


def _with_comments(text: str, *others: str) -> str:
    """The text of a rig file with the texts of all entries above them, from the schema.

    `others`: sections that such a rig does not have.
    """
    schema = _schema()
    sections = {name: section for name, section in schema["$defs"].items() if name not in others}
    lines = []
    for line in text.splitlines():
        name = line.removeprefix("# ").partition(":")[0]
        if name in schema["properties"] and name != "format":
            lines += ["", *_make_comment(name, schema["properties"][name], sections)]
        lines.append(line)
    return "\n".join(lines) + "\n"


@cache
def _schema() -> dict[str, Any]:
    return adapter(Rig).json_schema()


def _make_comment(
    name: str, entry: dict[str, Any], sections: Mapping[str, Any], depth: int = 0
) -> Iterator[str]:
    """The text of an entry, its default, and those of the entries in it."""
    default = entry.get("default")
    plain = isinstance(default, str | int | float)
    text = f"{name}: {entry['description']}{f' Default: {default}.' if plain else ''}"
    indent = "# " + "  " * depth
    yield from textwrap.wrap(
        text, _WIDTH, initial_indent=indent, subsequent_indent=indent + "    ", break_on_hyphens=False
    )
    kinds = [
        sections[kind] for kind in re.findall(r"'\$ref': '#/\$defs/(\w+)'", str(entry)) if kind in sections
    ]
    for kind in kinds:
        entries = kind["properties"]
        if "const" in entries.get("kind", {}):
            yield from _make_comment(f"kind {entries['kind']['const']}", kind, {}, depth + 1)
        for inner_name, inner in entries.items():
            if "const" not in inner:
                yield from _make_comment(inner_name, inner, sections, depth + 1)


def _scalar(text: str) -> str:
    """A text as YAML: as it is where it is one plain word that is read back the same, otherwise quoted."""
    if not re.search(r"[\s,{}\[\]]", text):
        with suppress(InputError):
            if parse_yaml(f"name: {text}\n".encode(errors="replace"), "") == {"name": text}:
                return text
    style = "'" if text.isprintable() else '"'
    return dump_yaml(text, default_style=style).strip()


def _fill_head(name: str, kind: str, board: str, port: str, retriggerable: str, in_series: bool) -> str:
    connections = wiring(MOTORS, in_series=in_series)
    rows = [f"  - {{channel: {c.channel}, spring: {c.spring}, face: {c.face}}}" for c in connections]
    return _HEAD.format(
        name=name,
        kind=kind,
        board=board,
        port=port,
        count=len(connections),
        rating=CONTACT_RATING_A,
        timer=_timer_entry(board, retriggerable),
        channels="\n".join(rows),
    )


def _timer_entry(board: str, value: str) -> str:
    driver = get_board(board).driver
    if not driver.times_pulses or driver.retriggerable is not None:
        return ""
    return f"  retriggerable: {value}\n"
