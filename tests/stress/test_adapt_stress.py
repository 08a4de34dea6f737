"""An adaptation whose program is killed at random instants, and which goes on."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from eldir_calibration.adaptation.runs import Adaptation
from tests.calibration.adaptation import short_adaptation
from tests.hardware.rigs_and_schedules import rig_text
from tests.paths import DATA, ROOT

pytestmark = pytest.mark.stress

ELDIR = [sys.executable, "-m", short_adaptation.__name__]
KILLS, RUNS, SEED = 10, 2, 50


def test_an_adaptation_that_is_killed_goes_on_with_the_same_decisions(tmp_path: Path) -> None:
    """Every belief, schedule and summary has the bytes of the adaptation that nobody disturbed, and so has
    every log that counts. No run is left out, and none counts twice."""
    rig = rig_text(seed=4, design="design.json", physics="mujoco")
    (tmp_path / "rig.yaml").write_text(rig.replace("rate_hz: 10", "rate_hz: 3"))  # fewer pictures to draw
    (tmp_path / "design.json").write_bytes((DATA / "demo-design.json").read_bytes())
    begin = time.monotonic()
    assert start(tmp_path, "whole").wait() == 0
    lasted = time.monotonic() - begin
    assert len(Adaptation.load(tmp_path / "whole" / "adaptation.json").runs) == RUNS
    instants = np.random.default_rng(SEED).uniform(0.0, lasted, KILLS)
    killed = iter(instants)
    for number in count(1):
        if not kill_until_it_ends(tmp_path, f"killed_{number}", killed):
            break
    print(f"undisturbed: {lasted:.0f} s; killed after {', '.join(f'{t:.0f}' for t in instants)} s")
    for folder in sorted(path for path in tmp_path.glob("killed_*") if path.is_dir()):
        assert decisions(folder) == decisions(tmp_path / "whole")
        print(f"{folder.name}: {len(list(folder.rglob('interrupted_*.mcap')))} runs repeated")


def kill_until_it_ends(place: Path, out: str, instants: Iterator[float]) -> bool:
    """Start an adaptation, kill it and start it again, until one ends by itself. Returns whether instants are
    left."""
    for instant in instants:
        program = start(place, out)
        try:
            assert program.wait(instant) == 0
            return True
        except subprocess.TimeoutExpired:
            program.kill()
            program.wait()
            done = place / out / "adaptation.json"
            runs = len(Adaptation.load(done).runs) if done.exists() else 0
            print(f"{out}: killed after {instant:.0f} s with {runs} of {RUNS} runs")
    assert start(place, out).wait() == 0
    return False


def start(place: Path, out: str) -> subprocess.Popen[bytes]:
    """Start the command; its output goes into a file."""
    command = [*ELDIR, "adapt", "design.json", "--rig", "rig.yaml", "--out", out, "--runs", str(RUNS)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with (place / f"{out}.txt").open("ab") as output:
        return subprocess.Popen(
            [*command, "--unattended"], cwd=place, env=environment, stdout=output, stderr=output
        )


def decisions(folder: Path) -> dict[str, bytes]:
    """Contents of the files that hold what was believed, decided and filmed."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.suffix in (".json", ".mcap") and not path.name.startswith(("interrupted_", "."))
    }
