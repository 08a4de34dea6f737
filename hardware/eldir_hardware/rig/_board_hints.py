"""Board, ports and name in a rig file that may be damaged."""

from __future__ import annotations

import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path

_MAX_BYTES = 65_536  # read of a file [bytes]
_MAX_PORTS = 8
_SENSOR = re.compile(
    r"""^sensor[ \t]*:(?:[^\n]*)(?:\n[ \t]+[^\n]*)*|["']?\bsensor["']?\s*:\s*\{[^{}]*\}""", re.MULTILINE
)
_VALUE = r"""["']?%s["']?\s*:\s*(?:"([^"\n]*)"|'([^'\n]*)'|([^\s,}#"'][^\s,}#]*))"""


@dataclass(frozen=True)
class BoardHints:
    """Entries of a rig file that may be damaged."""

    ports: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    """Values of all entries `kind`, also of other sections."""
    channels: int | None = None
    name: str | None = None
    virtual: bool = False
    sensor: bool = False
    """Whether it names a current sensor."""
    problem: str | None = None
    """Why the file cannot be read."""

    @property
    def is_portless(self) -> bool:
        """Whether it is a virtual rig, whose port is another one in each run."""
        return self.virtual and not self.ports


def read_board_hints(path: Path) -> BoardHints:
    """Read the entries line by line; missing ones are left out. Raises nothing."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
        with os.fdopen(handle, "rb") as file:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                return BoardHints(problem=f"{path} is not a file")
            text = file.read(_MAX_BYTES).decode(errors="replace")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        return BoardHints(problem=f"cannot read {path}: {reason}")
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    text = "\n".join(lines)
    board = _SENSOR.sub("", text)
    ports = _ports(board) or _ports(text)  # in a damaged file the board's port may be in the sensor's section
    counts = [int(n) for n in _values(text, "channels") if re.fullmatch(r"[0-9]{1,3}", n)]
    kinds = _values(text, "kind")
    return BoardHints(
        tuple(dict.fromkeys(ports))[:_MAX_PORTS],
        tuple(dict.fromkeys(kinds)),
        counts[0] if counts else None,
        _name(text),
        re.search(r"^kind\s*:\s*virtual\b", text, re.MULTILINE) is not None,
        board != text,
    )


def find_port_problem(port: str) -> str | None:
    """Why this is not a serial port of this computer; None if it may be one, connected or not."""
    if not port.strip():
        return "the name of the port is empty"
    if not port.isprintable():
        return f"invalid characters in the name of port {port!r}"
    if "://" in port:
        return f"{port} is not a serial port of this computer"
    return f"{port} is a folder" if os.path.isdir(port) else None


def _ports(text: str) -> list[str]:
    return [p for p in _values(text, "port") if p not in ("null", "~")]


def _name(text: str) -> str | None:
    """The name of the rig, which may have spaces."""
    match = re.search(r"^name\s*:[ \t]*([^\n]*?)[ \t]*(?:[ \t]#[^\n]*)?$", text, re.MULTILINE)
    return match[1].strip("\"'") if match and match[1] else None


def _values(text: str, key: str) -> list[str]:
    pattern = re.compile(r"(?<![\w-])" + _VALUE % key)
    return [value for groups in pattern.findall(text) if (value := "".join(groups).strip())]
