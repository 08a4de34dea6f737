"""Shared by the tests of guardian and others."""

import time
from pathlib import Path

import yaml
from typer.testing import CliRunner

from hardware.commands.rig import rig as command
from hardware.rig.template import virtual_rig


def rig_file(path: Path, kind: str, port: str, **changes: object) -> Path:
    """A complete rig of kind real on that port."""
    values = yaml.safe_load(virtual_rig(board=kind))
    del values["camera"], values["virtual"]
    values |= {"kind": "real", "board": values["board"] | {"port": port}} | changes
    path.write_text(yaml.safe_dump(values))
    return path


def wait(condition, seconds: float = 15.0) -> bool:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.005)
    return condition()


def run(*arguments: object):
    return CliRunner().invoke(command, [str(a) for a in arguments])
