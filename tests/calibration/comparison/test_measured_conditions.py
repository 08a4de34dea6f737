"""Air and current that were measured in a run replace what the rig file assumes, and narrow predictions."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from eldir.built.gait import Gait
from eldir.built.samples import NominalRobots
from eldir.lattice import Lattice
from eldir_calibration.comparison import recorded_run
from eldir_calibration.comparison.predictions import predict_runs
from eldir_calibration.comparison.recorded_run import LoggedRun, MeasuredConditions, read_run
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.virtual.rig import VirtualRig, room_temperature
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_text
from tests.raised import raises

SEED = 11


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> LoggedRun:
    """A run on a rig with a current sensor, whose air was measured."""
    folder = tmp_path_factory.mktemp("measured")
    text = rig_text(seed=SEED).replace("# sensor: {kind: ina226", "sensor: {kind: ina226")
    (folder / "rig.yaml").write_text(text.replace("camera:", "# camera:"))
    design, rig = make_design(3, Lattice(3, 6)), Rig.load(folder / "rig.yaml")
    design.save(folder / "design.json")
    springs = tuple(np.flatnonzero(design.morphology.active).tolist())
    gait = Gait(12.0, np.array([0.0, 0.875]), np.full(2, 0.2))
    schedule = compile_schedule(gait, rig, springs, cycles=2)
    room = round(room_temperature(rig), 1)
    config = DriveConfig(folder / "design.json", "not of a search", room_c=room)
    drive_rig(schedule, rig, folder / "rig.yaml", folder / "log.mcap", config)
    return read_run(folder / "log.mcap")


def test_they_are_those_of_the_hidden_rig(run: LoggedRun) -> None:
    with VirtualRig(run.rig, SimpleNamespace()) as virtual:
        hidden = virtual.springs.parameters
    assert run.log.room_c == pytest.approx(hidden[0].ambient, abs=0.06)
    amperes = float(np.mean([s.current(0.0) for s in hidden]))
    nominal, tolerances = run.nominal
    assert abs(amperes / 3.45 - 1) > 0.01, "otherwise nothing is shown"
    assert float(nominal.springs.current(0.0)) == pytest.approx(amperes, rel=run.measured.current_error)
    assert nominal.springs.ambient == run.log.room_c
    assumed = run.rig.spring_tolerances()
    assert tolerances.current < assumed.current / 2
    assert tolerances.ambient_max - tolerances.ambient_min < (assumed.ambient_max - assumed.ambient_min) / 5
    assert (tolerances.convection, tolerances.stroke) == (assumed.convection, assumed.stroke)


def test_predictions_take_them(run: LoggedRun) -> None:
    """The nominal robot moves otherwise, and samples have narrower air and currents."""
    assumed = replace(run, measured=MeasuredConditions())
    sent = [r.without_log() for r in (run, assumed)]
    mine, theirs = (predict_runs([r], None, 2).own[0].trajectory.positions for r in sent)
    assert np.abs(mine - theirs).max() > 5e-4
    spreads = []
    for one in (run, assumed):
        robot, tolerances = one.nominal
        samples = NominalRobots(run.design.morphology, robot, tolerances=tolerances).samples(60, 1)
        spreads.append(np.std([(r.springs.ambient, r.springs.current_limit) for r in samples], axis=0))
    assert (spreads[0] < spreads[1] / 2).all(), spreads


@pytest.mark.parametrize(
    ("amperes", "current", "told"),
    [
        ([3.6, 3.6, 3.6, 3.6], 3.6, "current 3.60 A (within 1.1%)"),
        ([3.57, 3.57, 3.57, 3.63], 3.585, "current 3.58 A (within 1.1%)"),
        ([3.4, 3.8, 3.4, 3.8], 3.6, "current 3.60 A (within 5.7%)"),
        ([3.4, 3.4, 3.4, 3.6], 3.45, "current 3.45 A (within 4.5%)"),
        ([3.6, 3.6, np.nan, 3.6], 3.6, "current 3.60 A in 3 of 4 springs (within 1.1%)"),
        ([3.4, np.nan, np.nan, 3.8], 3.6, "current 3.60 A in 2 of 4 springs (within 5.7%)"),
    ],
)
def test_a_current_is_told_as_far_as_it_is_that_of_all_springs(
    run: LoggedRun, monkeypatch: pytest.MonkeyPatch, amperes: list[float], current: float, told: str
) -> None:
    """Of unlike springs the spread counts, where the sensor's error of 1.14 % does not explain it: the root
    sum of squares of that and of the largest difference from the mean. Springs that were not measured keep
    the rig file's tolerance."""
    on = run.log.currents > 1.0
    log = replace(run.log, currents=np.where(on, np.broadcast_to(amperes, on.shape), run.log.currents))
    monkeypatch.setattr(recorded_run, "read_log", lambda path: log)
    measured = read_run(run.log.path).measured
    assert measured.current_a == pytest.approx(current) and str(measured).endswith(told)
    known = np.array([a for a in amperes if a > 0])
    spread = np.abs(known / current - 1).max()
    expected = 0.0114 if spread < 0.02 else np.hypot(0.0114, spread)
    assert measured.current_error == pytest.approx(expected, rel=0.02)
    assumed = run.rig.spring_tolerances().current
    _, left = replace(run, measured=measured).nominal
    assert left.current == (min(assumed, measured.current_error) if len(known) == 4 else assumed)


def test_air_outside_of_the_tolerances_is_refused(run: LoggedRun, tmp_path: Path) -> None:
    with raises(LimitError, "limit.room", match="found 31 C"):
        config = DriveConfig(room_c=31.0)
        drive_rig(run.schedule, run.rig, tmp_path / "rig.yaml", tmp_path / "log.mcap", config)
    assert not (tmp_path / "log.mcap").exists()
