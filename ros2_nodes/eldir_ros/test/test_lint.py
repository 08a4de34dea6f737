# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The linters of ament, as far as they do not contradict the style of this repository."""

import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = str(Path(__file__).parents[1])
CONFIGURATION = str(Path(__file__).parents[1] / "ament_flake8.ini")
OTHER_STYLE = {
    "D205": "a summary may have two lines, so no blank line follows its first one",
    "D209": "such a summary ends with the quotes on its last line",
    "D213": "a summary begins on the first line; D212 and D213 exclude each other",
    "D400": "the first of two lines does not end in a full stop; the last one does",
    "D401": "a function that returns something is described by what it returns",
    "D415": "as D400",
}
"""Codes of pep257 that the style of this repository contradicts, each with its reason."""


def test_every_file_names_its_licence():
    names = pytest.importorskip("ament_copyright.main", reason="needs ament_copyright")
    assert names.main(argv=[PACKAGE]) == 0


def test_flake8_with_the_exceptions_of_its_file():
    pytest.importorskip("ament_flake8.main", reason="needs ament_flake8")
    # In a process of its own: flake8 forks, and a fork of a process with ROS threads may never end.
    command = [sys.executable, "-m", "ament_flake8.main", "--config", CONFIGURATION, PACKAGE]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout


def test_docstrings():
    pep257 = pytest.importorskip("ament_pep257.main", reason="needs ament_pep257")
    assert pep257.main(argv=["--add-ignore", *OTHER_STYLE, "--", PACKAGE]) == 0
