"""What a report predicts beside the camera, and the process that does it meanwhile."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from eldir.built.gait import Gait
from eldir.built.motion import OK, PrintedMotion
from eldir.built.samples import NominalRobots, sample_walks
from eldir.built.scene import PrintedScene
from eldir.core.records import FloatArray
from eldir.core.worker_process import WorkerProcess
from eldir.design import Ballast, Variant
from eldir.errors import EldirError, InputError
from eldir.lattice import Lattice
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.trajectory import Trajectory
from eldir_app.commands.show import show
from eldir_cad.packet.folder import apply_variant
from eldir_calibration.comparison import predictions
from eldir_calibration.comparison.predictions import (
    predict_body,
    predict_live,
    predict_runs,
    predict_walk,
)
from eldir_calibration.comparison.recorded_run import LoggedRun, MeasuredConditions, RecordedRun
from eldir_calibration.dynamics.recording import Recording
from eldir_calibration.identification.identification import read_filmed_gait
from eldir_calibration.report.comparison import Motion
from eldir_calibration.report.verdict import prediction_interval
from eldir_hardware.log.reader import RunLog
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.player import RunResult
from eldir_hardware.safety.compatibility import with_digests
from tests.calibration.comparison.computed_aside import die, interrupted, refuse, square
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_text
from tests.raised import raises


def test_what_is_computed_aside_comes_back() -> None:
    with WorkerProcess("numpy") as worker:
        for x in (3.0, 4.0):
            worker.begin(square, x)
            assert worker.value() == x * x


@pytest.mark.parametrize(
    ("function", "arguments", "kind", "message"),
    [
        (refuse, ("motors",), InputError, "^no motors; expected some; found none$"),
        (die, (), EldirError, "process that computes in numpy died; found exit status -9"),
        (square, ("three",), TypeError, "multiply"),
    ],
)
def test_what_goes_wrong_aside_is_raised_here(
    function: Callable[..., None], arguments: tuple[str, ...], kind: type[Exception], message: str
) -> None:
    with WorkerProcess("numpy") as worker:
        worker.begin(function, *arguments)
        with pytest.raises(kind, match=message):
            worker.value()


def test_ctrl_c_is_for_the_one_who_asked() -> None:
    with WorkerProcess("numpy") as worker:
        worker.begin(interrupted, 3.0)
        assert worker.value() == 9.0


def test_nothing_outlives_the_one_who_asked() -> None:
    with pytest.raises(KeyboardInterrupt), WorkerProcess("numpy") as worker:
        raise KeyboardInterrupt
    assert worker._child.poll() == -signal.SIGKILL
    with WorkerProcess("numpy") as worker:
        child = worker._child
    assert child.poll() is not None


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    path.write_text(rig_text())
    rig, design = Rig.load(path), make_design(3, Lattice(3, 6))
    springs = tuple(np.flatnonzero(design.morphology.active).tolist())
    gait = Gait(12.0, np.array([0.0, 0.875]), np.full(2, 0.2))
    return RecordedRun(design, compile_schedule(gait, rig, springs, cycles=3), rig)


def same(a: Motion, b: Motion) -> bool:
    return a.trajectory == b.trajectory and (a.start, a.cycles, a.body_length) == (
        b.start,
        b.cycles,
        b.body_length,
    )


def test_all_robots_in_one_batch_move_as_each_alone(driven: RecordedRun) -> None:
    ballast = Variant(ballast=Ballast(9.0, 0))
    heavier = RecordedRun(replace(driven.design, variant=ballast), driven.schedule, driven.rig)
    nominal = RobotParameters(driven.robot.parameters, driven.rig.spring_parameters())
    known = PrintedScene.of(nominal.at(["hot_length"], [-1.0]), (), np.zeros((0, 0)))
    with WorkerProcess("eldir_calibration.comparison.predictions") as worker:
        worker.begin(predict_runs, [driven, heavier], known, 2)
        found = worker.value()
    evolved, alone = predict_live(driven.design, driven.schedule, driven.rig).motions.values()
    assert found.before is not None and same(found.before, alone) and same(found.evolved, evolved)
    soft, heavy = (m.trajectory.positions for m in found.own)
    assert np.abs(soft - alone.trajectory.positions).max() > 1e-3
    assert np.abs(heavy - soft).max() > 1e-3
    assert 0 < len(found.others) <= 5 and {m.cycles for m in found.others} == {2}
    assert all(m.trajectory.times[-1] < alone.trajectory.times[-1] for m in found.others)


def test_a_scene_may_know_that_heat_passes_between_springs(driven: RecordedRun) -> None:
    body = driven.design.morphology
    assert len(np.unique(body.springs[body.active])) == 3, "the motors have a hub in common"
    nominal, found = RobotParameters(driven.robot.parameters, driven.rig.spring_parameters()), []
    for value in (0.0, 0.03):
        springs = replace(nominal.springs, neighbour_conductance=value)
        scene = PrintedScene.of(replace(nominal, springs=springs), (), np.zeros((0, 0)))
        found.append(predict_runs([driven], scene, 1))
    without, passed = found
    assert without.before is not None and passed.before is not None and same(without.before, passed.before)
    own = [motions.own[0].trajectory.positions for motions in found]
    assert np.abs(own[1] - own[0]).max() > 1e-4
    assert passed.samples(1).fell == 1, "a sample was heated too: without its hubs it would be refused"


def test_the_predicted_walk_is_filmed(driven: RecordedRun, tmp_path: Path) -> None:
    """`eldir show --schedule`: the nominal robot of the rig, ten times as fast as it walks."""
    design, schedule, rig, film = (tmp_path / n for n in ("d.json", "s.json", "rig.yaml", "walk.webp"))
    driven.design.save(design)
    with_digests(driven.schedule, driven.rig, driven.design).save(schedule)
    rig.write_bytes(driven.rig.source)
    show(design, film, schedule, rig)
    with Image.open(film) as moving:
        assert moving.n_frames == 3 * 12 + 1, "ten pictures a second, ten seconds in a second"
        pictures = []
        for number in (0, 18, 36):
            moving.seek(number)
            pictures.append(np.asarray(moving.convert("RGB"), dtype=int))
    assert pictures[0].shape[1] == 640
    assert min(np.abs(a - b).max() for a, b in pairwise(pictures)) > 100, "it moved"
    with raises(InputError, "schedule.other-rig"):
        show(design, tmp_path / "other.webp", schedule)  # the rig of a new rig file has another current


def test_samples_are_those_that_a_gait_was_planned_with(driven: RecordedRun) -> None:
    """The same ones of six fall, and one that stays where it is does so in both."""
    design = make_design(10, Lattice(3, 6))
    springs = tuple(np.flatnonzero(design.morphology.active).tolist())
    gait = Gait(20.0, np.array([0.0, 0.125]), np.full(2, 0.27))
    schedule = compile_schedule(gait, driven.rig, springs, cycles=3)
    run = RecordedRun(design, schedule, driven.rig)
    found = predict_runs([run], samples=6).samples(3)
    over_time = predict_walk(run, 6)  # what the live page shows
    told = prediction_interval(found.walks)
    np.testing.assert_allclose(over_time[-1, 1:] * 5 / 3, [told.mean, told.low, told.high], atol=0.02)
    assert over_time[0].tolist() == [schedule.start_of_cycles, 0.0, 0.0, 0.0]
    assert over_time[-1, 0] == pytest.approx(schedule.duration, abs=0.1)
    robots = NominalRobots(
        design.morphology, RobotParameters(BuiltParameters(), driven.rig.spring_parameters())
    )
    (planned,) = sample_walks(robots, [gait], 6, 0)
    stand = np.isfinite(planned.displacement)
    assert 2 <= stand.sum() < 6, "some fall"
    assert np.isfinite(found.walks).tolist() == stand.tolist() and found.fell == (~stand).sum()
    assert (np.sign(found.walks[stand]) == np.sign(planned.displacement[stand])).all()
    assert (found.ranges[stand] > 5e-4).all() and (found.swings[stand] > 5e-4).all()


def test_a_control_robot_follows_the_intact_ones_schedule(driven: RecordedRun) -> None:
    """What its own motors have of it; the other channels heat nothing. Also in an identification."""
    control = replace(driven, design=apply_variant(driven.design, Variant(without_motor=0)))
    assert control.design.morphology.motors == 1 < len(driven.schedule.springs)
    (spring,) = np.flatnonzero(control.design.morphology.active).tolist()
    alone = compile_schedule(Gait(12.0, np.zeros(1), np.full(1, 0.2)), driven.rig, (spring,), cycles=3)
    found = predict_runs([control], samples=1).own[0]
    assert same(found, predict_runs([replace(control, schedule=alone)], samples=1).own[0])
    assert len(predict_runs([driven, control], samples=1).own) == 2
    tracked = found.trajectory
    log = RunLog(
        Path("log.mcap"), tracked, (), *[np.zeros(0)] * 2, (), *[np.zeros(0)] * 2, (), {}, 0, 0, None
    )
    film = Recording(tracked, np.zeros((1, 1)), found.start, found.period, found.cycles)
    seen = read_filmed_gait(LoggedRun(control.design, control.schedule, control.rig, log=log), film)
    assert seen is not None and seen.gait.phase.tolist() == [0.0]
    assert seen.gait.duty == pytest.approx([0.2])


def test_a_sample_that_falls_is_no_walk(driven: RecordedRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eldir.built.walking.TOPPLED_ANGLE", 0.0)
    found = predict_runs([driven], samples=2)
    assert [found.samples(n).fell for n in (1, 2, 3)] == [2] * 3 and np.isnan(found.samples(3).swings).all()
    assert len(found.own) == 1, "the nominal robot's motion is shown all the same"


def test_samples_are_compared_over_the_cycles_that_were_filmed(
    driven: RecordedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As samples of a shorter schedule: one that falls in cycle 3 walks through the first two."""
    schedule = driven.schedule
    frames = [int((schedule.start_of_cycles + n * schedule.period_s) / 0.05) // 20 for n in range(4)]
    fall = {"at": frames[3] + 9}

    def stand(robot: object, motion: PrintedMotion, lengths: FloatArray) -> bool:
        return motion.status == OK and len(motion.positions) <= fall["at"]

    monkeypatch.setattr("eldir_calibration.comparison.predictions.stays_upright", stand)
    every = predict_runs([driven], samples=2)
    assert [every.samples(n).fell for n in (1, 2, 3)] == [0, 0, 0]
    shorter = replace(driven, schedule=replace(schedule, cycles=2))
    alone, part = predict_runs([shorter], samples=2).samples(2), every.samples(2)
    np.testing.assert_allclose(part.walks, alone.walks, atol=1e-9)
    np.testing.assert_allclose(part.ranges, alone.ranges, atol=1e-9)
    fall["at"] = (frames[2] + frames[3]) // 2
    falling = predict_runs([driven], samples=2)
    assert [falling.samples(n).fell for n in (1, 2, 3)] == [0, 0, 2]


def test_a_run_that_ended_early_has_its_whole_cycles(driven: RecordedRun) -> None:
    said = ((20.0, "player", "playing"), (41.0, "player", "emergency stop"), (41.0, "log", "too slow"))
    none = np.zeros(0)
    log = RunLog(
        Path("log.mcap"), None, (), none, none.astype(bool), (), none, none, said, {}, 300, 0, None
    )  # fmt: skip
    logged = LoggedRun(driven.design, driven.schedule, driven.rig, log=log)
    start, period = driven.schedule.start_of_cycles, driven.schedule.period_s

    def motion(end: float) -> Motion:
        times = np.arange(0, end, 0.1)
        return logged.motion(Trajectory(("m1",), times, np.zeros((len(times), 1, 2))))

    assert motion(start + 3 * period + 0.1).cycles == motion(start + 9 * period).cycles == 3
    assert motion(start + 2.5 * period).cycles == motion(start + 2.78 * period).cycles == 2
    # Two frames of 0.1 s, of which the last one is at the end, may be missing.
    assert (motion(start + 3 * period - 0.05).cycles, motion(start + 3 * period - 0.25).cycles) == (3, 2)
    stopped = "{} of 3 cycles of log.mcap count; last message of its player: emergency stop."
    assert [logged.describe_missing_cycles(n) for n in (2, 3)] == [stopped.format(2), stopped.format(3)]
    for status in ((), (*said, (90.0, "player", RunResult(0.0, 0.0, 0.0).ended))):
        whole = replace(logged, log=replace(log, statuses=status))
        assert whole.describe_missing_cycles(3) == "" != whole.describe_missing_cycles(2)
    with raises(InputError, "log.too-short", match=r"log\.mcap .*last message of its player: emergency stop"):
        motion(start + 0.5 * period)


def test_cycles_after_a_pause_do_not_count(driven: RecordedRun) -> None:
    """The interrupted cycle is played again a period later: by the schedule's times a robot that walks 0.02 m
    in each cycle would stand still in one."""
    start, period = driven.schedule.start_of_cycles, driven.schedule.period_s
    t, none = np.arange(0, start + 4 * period, 0.1), np.zeros(0)
    pause = start + 1.5 * period
    shifted = np.where(t < pause, t, np.maximum(t - period, start + period))
    x = np.stack([0.02 * (shifted - start) / period, np.full(len(t), 0.03)], axis=1)[:, None]
    trajectory = Trajectory(("m1",), t, x)

    def logged(*said: tuple[float, str]) -> LoggedRun:
        statuses = tuple(
            (at, "player", text) for at, text in (*said, (t[-1], RunResult(0.0, 0.0, 0.0).ended))
        )
        log = RunLog(
            Path("log.mcap"), None, (), none, none.astype(bool), (), none, none, statuses, {}, 300, 0, None
        )  # fmt: skip
        return LoggedRun(driven.design, driven.schedule, driven.rig, log=log)

    resumed = (pause + 1.0, "resumed: cycle 3 begins again")
    run = logged((pause, "paused in cycle 3"), resumed)
    motion, blind = run.motion(trajectory), logged().motion(trajectory)
    walk = 5 * 0.02 / run.robot.body_length
    assert motion.displacements() == pytest.approx([walk])
    assert blind.cycles == 3 and blind.displacement() < 0.9 * walk, "a film that does not tell of the pause"
    told = f"1 of 3 cycles of log.mcap count; paused at {pause:.1f} s, later cycles do not count; "
    assert run.describe_missing_cycles(motion.cycles).startswith(told)
    for early in (2.0, start + 0.9 * period):
        with raises(InputError, "log.too-short", match=f"paused at {early:.1f} s"):
            logged((early, "paused in cycle 1"), resumed).motion(trajectory)
    late = logged((start + 2 * period + 0.05, "paused in cycle 4"))
    assert late.motion(trajectory).cycles == 2, "a pause between two cycles takes none of those before"


def test_the_robot_has_hubs_unless_the_engine_moves_it(driven: RecordedRun) -> None:
    """The virtual robot that the engine moves has pins; one in MuJoCo and a real one have hubs."""
    paths = []
    for rig in (
        driven.rig,
        driven.rig.model_copy(
            update={"virtual": driven.rig.virtual.model_copy(update={"physics": "mujoco"})}
        ),
        driven.rig.model_copy(update={"kind": "real"}),
    ):
        motion = predict_live(driven.design, driven.schedule, rig).motions["predicted"]
        paths.append(motion.trajectory.positions)
    pins, mujoco, real = paths
    assert np.array_equal(mujoco, real) and np.abs(pins - real).max() > 1e-5


def test_a_live_prediction_is_in_the_measured_air(driven: RecordedRun) -> None:
    """As the live page and the report predict the same run."""
    known = replace(driven, measured=MeasuredConditions(26.0))
    of_run = (driven.design, driven.schedule, driven.rig)
    warm, usual = (predict_live(*of_run, room).body.positions for room in (26.0, None))
    np.testing.assert_array_equal(warm, predict_body(known).positions)
    assert np.abs(warm - usual).max() > 1e-4


def test_other_bodies_are_built_with_the_rig_of_the_run(
    driven: RecordedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[RobotParameters] = []

    def no_others(design: object, robot: RobotParameters) -> list[object]:
        asked.append(robot)
        return []

    monkeypatch.setattr(predictions, "sample_other_robots", no_others)
    rig = driven.rig.model_copy(update={"kind": "real"})
    assert predict_runs([replace(driven, rig=rig)], samples=2).others == []
    assert asked == [rig.nominal_robot()] and asked[0].printed.joints == "hubs"
