"""Every example is short, runs as it stands and prints what it says (`read_log.py`: in test_demo.py)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.paths import ROOT

pytestmark = pytest.mark.slow

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
PRINTS = {
    "drive_printed_robot.py": "marks.png",
    "evolve_and_teach.py": "the run is in",
    "fit_stiffness.py": "stiffness: 1.2",
    "gradient_check.py": "central difference",
    "own_loss.py": "update 5",
    "own_relay_board.py": "contact 2 closed",
    "rugged_ground.py": "rugged_ground.png",
    "search_gait.py": "body lengths per five cycles",
}
"""A part of what each prints."""


def test_every_example_is_known_and_short() -> None:
    assert {path.name for path in EXAMPLES} == {*PRINTS, "read_log.py"}
    for path in EXAMPLES:
        most = 50 if path.name == "own_relay_board.py" else 40  # a driver and an emulator
        assert len(path.read_text().splitlines()) <= most, path.name


@pytest.mark.parametrize("path", [p for p in EXAMPLES if p.name != "read_log.py"], ids=lambda p: p.stem)
def test_examples_run(path: Path, tmp_path: Path) -> None:
    places = os.environ | {"TMPDIR": str(tmp_path)}
    ran = subprocess.run(
        [sys.executable, str(path)], cwd=tmp_path, env=places, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert PRINTS[path.name] in ran.stdout
