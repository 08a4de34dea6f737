"""A virtual rig whose robot MuJoCo moves: the same board, heat, camera and log."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.core.worker_process import WorkerProcess
from eldir.errors import EldirError
from eldir.lattice import Lattice
from eldir_app.application import application
from eldir_calibration.comparison.motions import prepare_report
from eldir_calibration.comparison.recorded_run import open_run
from eldir_hardware.log.reader import read_log
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.biplane_body import BiplaneBody
from eldir_hardware.virtual.bodies import BodyProcess
from eldir_hardware.virtual.impossible_motion import OverlapCheck
from eldir_hardware.virtual.rig import BodyFrame
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import gait, rig_text

pytest.importorskip("mujoco")  # installed with the extra `test`
DESIGN = make_design(3, Lattice(3, 6))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("mujoco")
    DESIGN.save(where / "design.json")
    for name, lines in (("rig", ""), ("far", "  parameter_spread: large\n")):
        text = rig_text(4, "design.json", physics="mujoco").replace("rate_hz: 10}", "rate_hz: 2}")
        (where / f"{name}.yaml").write_text(text + lines)
    return where


def short(rig: Rig) -> ActuationSchedule:
    """One heating of both springs."""
    whole = compile_schedule(
        gait(period=15.0, duty=(0.27, 0.27)),
        rig,
        springs=tuple(np.flatnonzero(DESIGN.morphology.active).tolist()),
    )
    return with_digests(
        ActuationSchedule(
            whole.period_s,
            events=whole.events,
            cycles=1,
            conditioning_cycles=0,
            settle_s=0.5,
            springs=whole.springs,
        ),
        rig,
        DESIGN,
    )


class EnoughError(Exception):
    """As many frames as the test looks at."""


def drive(folder: Path, name: str, log: str, *, frames: int = 1000) -> list[np.ndarray]:
    """Positions in a run, or in its first frames."""
    seen: list[np.ndarray] = []

    def see(frame: BodyFrame) -> None:
        seen.append(frame.positions)
        if len(seen) == frames:
            raise EnoughError

    rig = Rig.load(folder / f"{name}.yaml")
    with suppress(EnoughError):
        drive_rig(short(rig), rig, folder / f"{name}.yaml", folder / log, DriveConfig(on_body=see))
    return seen


@pytest.fixture(scope="module")
def seen(folder: Path) -> list[np.ndarray]:
    """Positions in a run whose log is log.mcap."""
    return drive(folder, "rig", "log.mcap")


def test_a_run_is_filmed_and_its_log_says_which_physics_moved_the_robot(
    folder: Path, seen: list[np.ndarray]
) -> None:
    log = read_log(folder / "log.mcap")
    assert log.frame_count == len(seen) > 20
    moved = np.array(seen)
    assert np.isfinite(moved).all() and np.ptp(moved, axis=0).max() > 1e-3, "the body moves"
    assert any("moved by MuJoCo" in message for _, part, message in log.statuses if part == "virtual rig")
    run = open_run(folder / "log.mcap", DESIGN)
    assert run.physics_note.startswith(", moved by MuJoCo 4.")


def test_the_command_writes_the_same_bytes_and_warns_of_what_a_printed_robot_cannot_do(
    folder: Path, seen: list[np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = folder / "rig.yaml"
    short(Rig.load(rig)).save(folder / "schedule.json")
    command = ["rig", "drive", str(folder / "schedule.json"), "--rig", str(rig), "--log"]
    result = CliRunner().invoke(application(), [*command, str(folder / "again.mcap")])
    assert (folder / "log.mcap").read_bytes() == (folder / "again.mcap").read_bytes(), "same seed, same bytes"
    told = open_run(folder / "again.mcap", DESIGN).impossible_motion
    assert told.startswith("the coil of spring 0-3 would buckle on a printed robot, first 6.")
    assert f"warning: not possible in reality: {told}\n" in result.stderr
    # It lies on its rear edge from the beginning, so that its report would be refused.
    monkeypatch.setattr("eldir_calibration.comparison.departure.find_fall", lambda *_: None)
    with WorkerProcess("eldir_calibration.comparison.predictions") as worker:
        thick = replace(DESIGN, other_parts=("bending", "strip"))
        content = prepare_report(folder / "again.mcap", thick, worker, samples=2)
    assert thick.parts_remark in content.remarks and "(bending, strip)" in thick.parts_remark
    assert f"The walk in again.mcap is not possible in reality: {told}." in content.remarks


def test_a_motion_that_no_real_robot_could_make_is_told(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(OverlapCheck, "worst_pair", lambda self, positions: "mass 1 and spring 2-3")
    drive(folder, "rig", "through.mcap", frames=3)
    run = open_run(folder / "through.mcap", DESIGN)
    assert run.impossible_motion.startswith("mass 1 and spring 2-3 pass through each other, first")
    assert run.physics_note.endswith(f", {run.impossible_motion}")


def test_a_far_robot_moves_otherwise(folder: Path, seen: list[np.ndarray]) -> None:
    far = drive(folder, "far", "far.mcap", frames=9)
    assert np.abs(seen[8] - far[8]).max() > 1e-3


def test_without_mujoco_nothing_is_heated_and_no_log_is_left(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(EldirError, match="pip install 'eldir"):
        drive(folder, "rig", "none.mcap")
    assert not (folder / "none.mcap").exists()


def test_a_worker_process_moves_the_same_robot(folder: Path) -> None:
    """Also one in space: the planar one crosses in the engine's test."""
    springs = Rig.load(folder / "rig.yaml").spring_parameters()
    given = DESIGN.morphology, 4, springs, DESIGN.ballast
    with BodyProcess("mujoco", *given, dimensions=3) as there:
        here = BiplaneBody(*given)
        lengths = np.full((2, DESIGN.morphology.motors, 2), 0.9 * springs.cold_length)
        for body in (here, there):
            body.move(lengths, 0.05)
        np.testing.assert_array_equal(there.positions, here.positions)
        assert there.discs is not None
        for ours, theirs in zip(here.discs, there.discs, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        worker = there._process
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # as when a terminal is closed
            os.kill(worker.pid, number)
        there.move(lengths, 0.02)
        worker.kill()
        worker.join()
        for _ in range(2):  # told as an error at the answer and at the next order: neither is a traceback
            with pytest.raises(EldirError, match="process died"):
                there.move(lengths, 0.02)
