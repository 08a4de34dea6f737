"""What a report says of each of its logs, and of those that a scene was identified from."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from eldir.built.scene import PrintedScene
from eldir.trajectory import Trajectory
from eldir_calibration.comparison.motions import TrackedRun, _describe_fit, _describe_scene, _remarks
from eldir_calibration.comparison.recorded_run import LoggedRun
from eldir_calibration.report.controls import INTACT, FilmedRun
from eldir_hardware.camera.plane import Plane
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.vision.tracking_quality import TrackingQuality
from tests.calibration.dynamics.hidden_rigs import SOFT
from tests.calibration.report.striding_walkers import CYCLES, walker
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import RIG, SCHEDULE, gait, rig_with

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


def remarks(
    names: tuple[str, ...], films: tuple[TrackedRun, ...], scene: PrintedScene | None = None
) -> tuple[str, ...]:
    filmed = [FilmedRun(n, INTACT, "", f.motion, walker()) for n, f in zip(names, films, strict=True)]
    return _remarks([run(name) for name in names], films, filmed, scene, has_ground=False)


def test_every_film_has_its_remarks_under_its_name() -> None:
    poor = film(SECOND_SET, drift=1.0, remark="The camera had moved.")
    found = remarks(("a.mcap", "b.mcap"), (film(), poor))
    assert f"b.mcap: {SECOND_SET}" in found and "b.mcap: The camera had moved." in found
    assert "b.mcap: The reference tags drifted by 1.0 px: fasten the camera." in found
    assert not any(remark.startswith("a.mcap") for remark in found)


def test_one_film_needs_no_name() -> None:
    found = remarks(("b.mcap",), (film(SECOND_SET, remark="The camera had moved."),))
    assert found == (SECOND_SET, "The camera had moved.")


def test_a_film_that_a_scene_was_identified_from_does_not_test_it() -> None:
    scene = PrintedScene.of(SOFT, ("friction",), 0.01 * np.eye(1))
    one, other = "1" * 64, "2" * 64
    fitted = FilmedRun("log.mcap", INTACT, "", walker(), walker(), one)
    known = replace(scene, provenance={"logs": ["log.mcap"], "fingerprints": [one]})
    assert _describe_fit(known, fitted).startswith("this film was used for the identification")
    assert _describe_fit(known, replace(fitted, log="renamed.mcap", fingerprint=one))
    assert _describe_fit(known, replace(fitted, fingerprint=other)) == "", "another film of that name"
    older = replace(scene, provenance={"logs": ["log.mcap"]})
    assert _describe_fit(older, fitted).startswith("a film of this name was used")
    assert _describe_fit(older, replace(fitted, log="new.mcap")) == ""
    assert _describe_fit(scene, fitted) == ""


def test_every_film_that_a_scene_was_identified_from_is_named() -> None:
    """The first one in the verdict, all others in remarks."""
    scene = replace(PrintedScene.of(SOFT, ("friction",), 0.01 * np.eye(1)), provenance={"logs": ["b.mcap"]})
    told = "b.mcap: A film of this name was used for the identification, so this may be no test."
    assert remarks(("a.mcap", "b.mcap"), (film(), film()), scene) == (told,)
    assert remarks(("b.mcap", "a.mcap"), (film(), film()), scene) == ()


def test_a_report_names_the_scene(tmp_path: Path) -> None:
    """By the digest of its file, as sha256sum prints it."""
    scene = PrintedScene.of(SOFT, ("friction",), 0.01 * np.eye(1))
    scene = replace(scene, provenance={"logs": ["a.mcap", "b.mcap"]})
    scene.save(tmp_path / "scene.json")
    digest = hashlib.sha256((tmp_path / "scene.json").read_bytes()).hexdigest()
    loaded = PrintedScene.load(tmp_path / "scene.json")
    assert _describe_scene(loaded) == f"identified from a.mcap, b.mcap; SHA-256 {digest}"


def heated(current: float | None = None, springs: tuple[int, ...] = (7, 12), **gaits: Any) -> LoggedRun:
    rig = RIG if current is None else rig_with(supply={"current_limit_a": current})
    schedule = compile_schedule(gait(**gaits), rig, springs=springs)
    return replace(run("a.mcap"), schedule=schedule, rig=rig)


def test_runs_with_other_heat_are_told_apart() -> None:
    first = heated()
    assert heated().describe_other_heating(first) == ""
    assert heated(phase=(0.25, 0.75)).describe_other_heating(first) == "", "a period begins anywhere"
    rounded = heated(phase=(0.30013, 0.80013))
    late = replace(
        rounded.schedule, events=tuple(replace(e, t_s=e.t_s + 1e-3 * e.on) for e in rounded.schedule.events)
    )
    assert replace(rounded, schedule=late).describe_other_heating(first) == "", "by a millisecond"
    assert heated(phase=(0.0, 0.25)).describe_other_heating(first) == "other pulses"
    assert heated(duty=(0.275, 0.2)).describe_other_heating(first) == "other pulses"
    told = heated(current=3.2, period=25.0, duty=(0.2, 0.2)).describe_other_heating(first)
    assert told == "a period of 25 s instead of 20 s and a current limit of 3.2 A instead of 3.45 A"


def test_a_control_robot_may_lack_a_motor() -> None:
    first = heated()
    assert heated(springs=(12,), phase=(0.0,), duty=(0.275,)).describe_other_heating(first) == ""
    assert heated(springs=(12,), phase=(0.0,), duty=(0.2,)).describe_other_heating(first) == "other pulses"


def test_a_run_with_other_heat_has_a_remark() -> None:
    filmed = [
        FilmedRun(name, INTACT, "", walker(), walker(), other_heating=other)
        for name, other in (("a.mcap", ""), ("b.mcap", "other pulses"))
    ]
    (told,) = _remarks([run("a.mcap"), run("b.mcap")], [film(), film()], filmed, None, has_ground=False)
    assert told.startswith(
        "b.mcap was heated otherwise than a.mcap, with other pulses: their walks are neither"
    )
