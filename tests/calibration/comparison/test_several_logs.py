"""What a report on several logs says of each film."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from eldir.trajectory import Trajectory
from eldir_calibration.comparison.motions import TrackedRun, _remarks
from eldir_calibration.comparison.recorded_run import LoggedRun
from eldir_calibration.report.controls import INTACT, FilmedRun
from eldir_hardware.camera.plane import Plane
from eldir_hardware.vision.tracking_quality import TrackingQuality
from tests.calibration.report.striding_walkers import CYCLES, walker
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import RIG, SCHEDULE

PLANE = Plane(640, 480, np.diag([2.0, -2, 1]), [320, 240], [0, 0], 0.1)
SECOND_SET = "A second set of markers appeared."


def run(name: str) -> LoggedRun:
    log: Any = SimpleNamespace(path=Path(name), statuses=())
    return LoggedRun(make_design(1), replace(SCHEDULE, cycles=CYCLES), RIG, log=log)


def film(*notes: str, drift: float = 0.1, **plane: str) -> TrackedRun:
    motion = walker()
    names, seen = run("a.mcap").names, motion.trajectory
    path = Trajectory(names, seen.times, np.repeat(seen.positions[:, :1], len(names), axis=1))
    sizes = np.ones(path.positions.shape[:2])
    quality = TrackingQuality.of(path, sizes, camera_drift_px=drift, notes=notes)
    return TrackedRun(motion, quality, replace(PLANE, provenance=plane), np.zeros((2, 2, 3), np.uint8))


def remarks(names: tuple[str, ...], films: tuple[TrackedRun, ...]) -> tuple[str, ...]:
    first = FilmedRun(names[0], INTACT, "", films[0].motion, walker())
    return _remarks([run(name) for name in names], films, first, has_ground=False)


def test_every_film_has_its_remarks_under_its_name() -> None:
    poor = film(SECOND_SET, drift=1.0, remark="The camera had moved.")
    found = remarks(("a.mcap", "b.mcap"), (film(), poor))
    assert f"b.mcap: {SECOND_SET}" in found and "b.mcap: The camera had moved." in found
    assert "b.mcap: The reference tags drifted by 1.0 px: fasten the camera." in found
    assert not any(remark.startswith("a.mcap") for remark in found)


def test_one_film_needs_no_name() -> None:
    found = remarks(("b.mcap",), (film(SECOND_SET, remark="The camera had moved."),))
    assert found == (SECOND_SET, "The camera had moved.")
