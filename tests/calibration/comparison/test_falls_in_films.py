"""A filmed robot that falls over in its plane of motion, with all markers in sight, and one that is lost."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import jsonschema
import numpy as np
import pytest

from eldir.built.gait import CYCLES, Gait
from eldir.core.worker_process import WorkerProcess
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir_app.catalogue.comparison import compared_run, write_comparison
from eldir_app.catalogue.facts import read_report
from eldir_calibration.comparison import motions, predictions
from eldir_calibration.comparison.motions import prepare_report, track_run
from eldir_calibration.comparison.predictions import PredictedMotions, predict_runs
from eldir_calibration.comparison.recorded_run import LoggedRun, read_run
from eldir_calibration.report.page import write_report
from eldir_calibration.report.verdict import RobotLoss
from eldir_hardware.camera.plane import FieldOfView
from eldir_hardware.log.mcap_file import fingerprint
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.calibration.adaptation.short_adaptation import make_walker
from tests.calibration.report.report_input import SCHEMA
from tests.hardware.rigs_and_schedules import rig_text
from tests.raised import raises

GAIT = Gait(20.0, np.array([0.0, 0.25]), np.full(2, 0.2))  # its second cycle, the first that counts: at 23 s
TOPPLES_S = 3.0
RIG = rig_text(seed=4, design="design.json")
DESIGN = make_walker()


@dataclass
class Computed:
    """A worker process that has predicted already."""

    motions: PredictedMotions

    def begin(self, *call: Any) -> None:
        pass

    def value(self) -> PredictedMotions:
        return self.motions


def film(path: Path, walk: float, falls: float = np.inf, lost: float = np.inf, cycles: int = 2) -> LoggedRun:
    """A run of a stiff robot that goes `walk` body lengths per five cycles, and topples backwards from
    `falls` [s] on; then it lies there. No marker is seen after `lost` [s]."""
    path.with_name("rig.yaml").write_text(RIG)
    made = compile_schedule(GAIT, Rig.load(path.with_name("rig.yaml")), cycles=cycles)
    body, rest = DESIGN.morphology, DESIGN.morphology.positions * BuiltParameters().scale
    near = np.arange(0.0, made.duration, 0.25)
    times = near[(near % 0.5 == 0) | (abs(near - falls) < 2 * TOPPLES_S)]
    angles = np.pi / 2 * np.clip((times - falls) / TOPPLES_S, 0.0, 1.0)
    turns = np.array([[[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]] for a in angles])
    corner = np.array([rest[:, 0].min(), 0.0])
    places = (rest - corner) @ turns + corner
    speed = walk * np.ptp(rest[:, 0]) / CYCLES / GAIT.period
    places[..., 0] += speed * np.minimum(times, falls)[:, None]
    camera = VirtualCamera(3, FieldOfView.around(places.reshape(-1, 2)))
    nothing = np.zeros((0, 2)), np.zeros((0, 2), int), np.zeros(0, int)
    with Recorder(path, [f"channel{c}" for c in range(1, 5)], []) as recorder:
        for name, value in {"schedule": made, "design": DESIGN, "tags": camera.board}.items():
            recorder.attach(f"{name}.json", json.dumps(value.to_json()).encode())
        recorder.attach("rig.yaml", RIG.encode())
        recorder.on_relays(0.0, [False] * 4)
        for t, there in zip(times.tolist(), places, strict=True):
            shown = (there, body.springs, DESIGN.marks) if t <= lost else nothing
            recorder.on_frame(t, camera.render(*shown))
    return read_run(path)


@pytest.fixture(scope="module")
def predicted(tmp_path_factory: pytest.TempPathFactory) -> PredictedMotions:
    folder = tmp_path_factory.mktemp("predicted")
    run = film(folder / "covered.mcap", 0.0, lost=-1.0).without_log()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(predictions, "sample_other_robots", lambda *_: [])
        return predict_runs([run], None, 4)


@pytest.mark.parametrize(
    ("falls", "lost", "cycles", "kind"),
    [
        (np.inf, np.inf, 2, None),
        (50.0, np.inf, 1, "fell"),  # in the second cycle that counts
        (np.inf, 50.0, 1, "lost"),
    ],
)
def test_a_robot_that_fell_or_was_lost_does_not_agree(
    tmp_path: Path,
    predicted: PredictedMotions,
    monkeypatch: pytest.MonkeyPatch,
    falls: float,
    lost: float,
    cycles: int,
    kind: str | None,
) -> None:
    """It goes just as predicted until then; no strip need join two markers for this to be told."""
    monkeypatch.setattr(motions, "measure_departure", lambda *_: None)
    walk = float(predicted.samples(1).walks.mean())
    path = tmp_path / "run.mcap"
    film(path, walk, falls, lost)
    told = prepare_report(path, DESIGN, cast(WorkerProcess, Computed(predicted)))
    write_report(told, tmp_path / "report")
    values = json.loads((tmp_path / "report" / "report.json").read_text())
    jsonschema.validate(values, SCHEMA)
    page = (tmp_path / "report" / "index.html").read_text()
    listed = read_report(tmp_path / "report" / "report.json")[fingerprint(path)]
    (run,) = values["runs"]
    assert run["cycles"] == cycles and run["tracked"] == pytest.approx(walk, abs=0.02)
    level = "agrees" if kind is None else "undecided"
    assert listed["verdict"] == level == values["verdict"]["body_lengths_per_5_cycles"]["agreement"]
    assert f'class="headline {level}"' in page and ("They agree" in page) == (kind is None)
    if kind is None:
        assert "loss" not in run and not any("count" in remark for remark in told.remarks)
        return
    # It lies where it has turned by 45 degrees, half of the way to the ground.
    when = lost if kind == "lost" else falls + TOPPLES_S / 2
    assert run["loss"] == {"time_s": pytest.approx(when, abs=0.3), "kind": kind}
    how = f"{'was lost' if kind == 'lost' else 'fell over'} at {run['loss']['time_s']:.1f} s"
    assert f"But the robot {how}; only cycles that ended before count" in listed["sentence"]
    begins = f"No marker after {when:.1f} s" if kind == "lost" else f"The robot {how}"
    assert any(remark.startswith(begins) for remark in values["warnings"])
    compared = compared_run(path, lambda done, total: None)
    write_comparison([compared], tmp_path / "both.html")
    assert compared.motion.cycles == cycles and f"<td>{how}</td>" in (tmp_path / "both.html").read_text()


def test_a_fall_before_the_first_cycle_ended_is_refused_as_a_loss_is(tmp_path: Path) -> None:
    run = film(tmp_path / "run.mcap", 0.0, falls=36.0, cycles=1)
    with raises(InputError, "film.lost", match=r"expected .* 43 s; found the robot fell over at 37\.\d s"):
        track_run(run, lambda frames: None)
    seen = track_run(run, lambda frames: None, through_falls=True)
    assert seen.motion.cycles == 1 and seen.loss is None, "an adaptation looks for falls itself"
    assert RobotLoss(37.5, "fell").phrase == "fell over at 37.5 s"
