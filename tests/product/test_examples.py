"""Every example is short, runs as it stands and prints what it says (`read_log.py`: in test_demo.py)."""

import runpy
import tempfile
from pathlib import Path

import pytest

from eldir.built import samples, screening, walking
from tests.paths import ROOT

pytestmark = pytest.mark.slow

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
PRINTS = {
    "body_and_controller.py": "update 11",
    "drive_printed_robot.py": "marks.png",
    "evolve_and_train.py": "the run is in",
    "fit_stiffness.py": "stiffness: 1.2",
    "gait_by_ribs.py": "cells; the best walks +1.",
    "gradient_check.py": "central difference",
    "heat_two_springs.py": "all contacts are open by the board's report",
    "own_loss.py": "update 5",
    "own_problem.py": "about 12 masses: 0.2",
    "own_relay_board.py": "contact 2 closed",
    "rugged_ground.py": "rugged_ground.png",
    "search_gait.py": "body lengths per five cycles",
    "two_robots.py": "soft +",
}
"""A part of what each prints."""
MOST_LINES = {"gait_by_ribs.py": 50, "own_problem.py": 60, "own_relay_board.py": 50}
"""Of those that have classes to write."""


def test_every_example_is_known_and_short() -> None:
    assert {path.name for path in EXAMPLES} == {*PRINTS, "read_log.py"}
    for path in EXAMPLES:
        assert len(path.read_text().splitlines()) <= MOST_LINES.get(path.name, 40), path.name


@pytest.mark.parametrize("path", [p for p in EXAMPLES if p.name != "read_log.py"], ids=lambda p: p.stem)
def test_examples_run(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the main program, but of this process: each would load the engine and its kernels anew. One cycle of
    printed robots counts, not five."""
    if "eldir.jax" in path.read_text() or "jax.numpy" in path.read_text():
        pytest.importorskip("jax", reason="JAX is not installed: pip install 'eldir[jax]'")
    if path.name == "gait_by_ribs.py":
        pytest.importorskip("ribs", reason="pyribs is not installed: pip install 'eldir[qd]'")
    monkeypatch.setattr(samples, "CYCLES", 1)
    monkeypatch.setattr(screening, "CYCLES", 1)
    monkeypatch.setattr(walking.walk, "__kwdefaults__", walking.walk.__kwdefaults__ | {"cycles": 1})
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    assert PRINTS[path.name] in capsys.readouterr().out
