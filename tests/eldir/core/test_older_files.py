"""Files that version 0.1.0 wrote are read, mean the same, and are written with the same bytes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from eldir.built.scene import PrintedScene
from eldir.evolution.printed.genome import Timing
from eldir.evolution.printed.run_folder import PrintedRunFile
from eldir.parameters.printed import BuiltParameters
from eldir.trajectory import Trajectory
from tests.paths import DATA

OLD = DATA / "old"


def rewritten(read: PrintedRunFile | Trajectory | PrintedScene, folder: Path) -> bytes:
    read.save(folder / "again.json")
    return (folder / "again.json").read_bytes()


def test_a_printed_run(tmp_path: Path) -> None:
    path = OLD / "printed-run.json"
    file = PrintedRunFile.load(path)
    assert (file.config.offspring, file.config.generations, file.config.seed) == (4, 2, 3)
    assert file.config.timings[0] == Timing(20.0, 6.0) and isinstance(file.config.timings[0], Timing)
    assert rewritten(file, tmp_path) == path.read_bytes()


def test_a_trajectory(tmp_path: Path) -> None:
    path = OLD / "trajectory.json"
    found, values = Trajectory.load(path), json.loads(path.read_text())
    assert found.names == ("m1", "m2", "m3") and found.times.tolist() == values["times_s"]
    known = np.array(values["positions_m"], dtype=float)
    assert np.array_equal(found.positions, known, equal_nan=True) and np.isnan(known).any()
    frames = {name: np.flatnonzero(found.bridged[:, k]).tolist() for k, name in enumerate(found.names)}
    assert {name: own for name, own in frames.items() if own} == values["bridged"] == {"m2": [2, 3]}
    assert found.provenance == {"log": "a.mcap", "n": 3}
    assert rewritten(found, tmp_path) == path.read_bytes()


def test_printed_parameters_of_version_0_1_0_have_pins() -> None:
    """They lack what came with hubs, and the tilt of the table."""
    values = {
        n: v for n, v in BuiltParameters(tension=5e3).to_json().items() if n not in BuiltParameters.OPTIONAL
    }
    assert BuiltParameters.from_json(values) == BuiltParameters(tension=5e3)
