"""Which runs count, and what is not heated: other robots, rigs and currents, pauses, falls, hot springs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.built.gait import Gait
from eldir.built.heat import HeatModel
from eldir.built.samples import IdentifiedRobots, SampledWalks
from eldir.built.scene import PrintedScene
from eldir.built.screening import candidate_gaits
from eldir.design import Ballast, Design, Variant
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir_app.application import application
from eldir_calibration.adaptation import films, loop
from eldir_calibration.adaptation.choice import (
    NoGaitError,
    believed_limits,
    believed_robots,
    require_cool,
)
from eldir_calibration.adaptation.films import nominal_robot, read_run
from eldir_calibration.adaptation.heat import peak_temperatures, planned_contact_shares
from eldir_calibration.adaptation.loop import adapt
from eldir_calibration.adaptation.page import write_page
from eldir_calibration.adaptation.prior import BELIEF, load_prior
from eldir_calibration.adaptation.runs import Adaptation, AdaptationRun, Fault, best_run, repeatable_runs
from eldir_calibration.comparison.recorded_run import open_run
from eldir_calibration.dynamics.belief import Belief
from eldir_calibration.dynamics.recording import INTERVAL, FilmedBody, find_any_fall
from eldir_calibration.identification.identification import RobotFilms, read_filmed_gait, read_recording
from eldir_hardware.camera.plane import FieldOfView
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.plan import heating_limits
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule, PredictedWalk
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.calibration.adaptation.short_adaptation import make_walker
from tests.hardware.rigs_and_schedules import rig_text
from tests.raised import raises


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    (tmp_path / "rig.yaml").write_text(rig_text(seed=4, design="design.json"))
    return Rig.load(tmp_path / "rig.yaml")


@pytest.fixture
def design() -> Design:
    return make_walker()


def schedule(rig: Rig, pulse: float, period: float = 30.0) -> ActuationSchedule:
    return compile_schedule(Gait(period, np.array([0.0, 0.5]), np.full(2, pulse / period)), rig)


def belief(design: Design, rig: Rig, current: float, misfit: float = 0.5) -> Belief:
    """Eight robots with about this much more current than the supply is set to, in prior deviations."""
    z = np.array([current, 0.0]) + 1e-3 * np.random.default_rng(1).standard_normal((8, 2))
    body = FilmedBody(design.morphology, design.marks, design.ballast / 2)
    return Belief(nominal_robot(rig), body, ("current", "friction"), z, misfit)


def test_nothing_is_heated_that_gets_too_hot_by_what_the_films_tell(rig: Rig, design: Design) -> None:
    """With longer pulses than those that were filmed, too; whatever the rig file proves for its springs."""
    short, long = schedule(rig, 3.0), schedule(rig, 6.0)
    hot = belief(design, rig, 1.5)
    require_cool(design, rig, short, believed_robots(design, rig, hot.scene, hot))
    with pytest.raises(NoGaitError, match=r"would reach \d+ C, .* the limit is 90 C. With a lower current"):
        require_cool(design, rig, long, believed_robots(design, rig, hot.scene, hot))
    with pytest.raises(NoGaitError):
        require_cool(design, rig, long, believed_robots(design, rig, hot.scene, None))  # of other robots
    for tells_nothing in (belief(design, rig, 0.0), belief(design, rig, 1.5, misfit=1.5)):
        require_cool(design, rig, long, believed_robots(design, rig, tells_nothing.scene, tells_nothing))
    assert believed_robots(design, rig, None, None) == []


def test_the_search_is_offered_pulses_that_keep_the_believed_springs_cool(rig: Rig, design: Design) -> None:
    """Shorter ones, where the longest that the rig file allows would be too hot: the adaptation goes on."""
    hot, limits, usual = belief(design, rig, 1.5), heating_limits(rig), candidate_gaits(2)[0]
    springs = IdentifiedRobots.of(design, hot.scene).robot.springs
    believed = believed_robots(design, rig, hot.scene, hot)
    cool = believed_limits(design, rig, springs, believed)
    assert limits.allowed(usual) and not cool.allowed(usual)
    period, duty = cool.timing(cool.springs, 2)
    offered = Gait(period, usual.phase, np.full(2, duty))
    assert cool.allowed(offered) and duty * period < usual.duty[0] * usual.period
    require_cool(design, rig, compile_schedule(offered, rig), believed)
    assert believed_limits(design, rig, springs, []).allowed(usual), "nothing is told"


def test_a_planned_schedule_heats_as_its_log_says(rig: Rig, design: Design) -> None:
    """Both contacts of a motor closed for six seconds of thirty. The nominal robot's springs are heated as
    one alone is by the heat model."""
    shares = planned_contact_shares(schedule(rig, 6.0), rig, 2)
    cycles = len(shares) * 0.05 / 30.0
    np.testing.assert_allclose(shares.sum(axis=0) * 0.05, 6.0 * int(cycles), atol=0.2)
    each = peak_temperatures(design.morphology, [nominal_robot(rig)] * 2, shares)
    alone = HeatModel([rig.spring_parameters()] * 2).run(shares, INTERVAL).temperature.max()
    np.testing.assert_allclose(each, alone)


def run(
    filmed: float, current: float = 3.6, upright: bool = True, lost: float | None = None
) -> AdaptationRun:
    known = (current, None, None, None, filmed, upright and lost is None, 3, None, lost)
    return AdaptationRun("schedule.json", "run.mcap", *known)


def test_the_best_run_is_one_that_the_supply_can_repeat() -> None:
    runs = [run(2.8), run(1.5), run(2.0, 3.4), run(9.0, upright=False)]
    hot = Fault(1, "hot", "the springs get hotter than the limit", "lower the current")
    assert best_run(runs, [], 3.6) == 1
    assert best_run(runs, [hot], 3.6) == 2 and best_run(runs, [hot], 3.4) == 3
    assert best_run(runs, [hot], 3.5) is None and repeatable_runs(runs, [hot], 3.6) == [2, 4]
    assert best_run(runs, [replace(hot, kind="fall")], 3.6) == 1


def test_a_run_in_which_the_robot_was_lost_is_the_best_only_if_there_is_no_other() -> None:
    lost, fallen = run(1.9, lost=95.0), run(9.0, upright=False)
    assert best_run([lost, run(0.4), fallen], [], 3.6) == 2
    assert best_run([run(1.2, lost=80.0), lost, fallen], [], 3.6) == 2
    assert AdaptationRun.from_json(lost.to_json()) == lost and "lost_at_s" not in run(1.0).to_json()


def test_page_and_command_tell_that_the_robot_was_lost(
    tmp_path: Path, rig: Rig, design: Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And that they do not know whether it fell; of a robot that stood to the end they say nothing."""
    words = "lost at 95 s: fell, left the picture or was covered"
    schedule(rig, 3.0).save(tmp_path / "schedule.json")
    design.save(tmp_path / "design.json")
    for one, told in ((run(1.9, lost=95.0), True), (run(1.9), False)):
        found = Adaptation((one,), 1, "all runs are made (1)")
        write_page(tmp_path, nominal_robot(rig), found, None, belief(design, rig, 0.3).scene)
        page = (tmp_path / "adaptation.html").read_text()
        head = page[page.index('class="sentence"') : page.index("Ended:")]
        assert (f"filmed in run 1 of 1; the robot was {words}." in head) == told
        assert (f"Run 1: {words}; only cycles that ended before count." in page) == told
        assert "+1.90" in head and page.count("lost at") == 2 * told and "<td>+1.90</td>" in page

        def adapted(
            *given: Any, one: AdaptationRun = one, found: Adaptation = found, **options: Any
        ) -> Adaptation:
            given[6](1, one)
            return found

        monkeypatch.setattr(loop, "adapt", adapted)
        call = ["adapt", str(tmp_path / "design.json"), "--rig", str(tmp_path / "rig.yaml")]
        output = CliRunner().invoke(application(), [*call, "--out", str(tmp_path / "new")]).output
        said = " ".join(output.split())
        assert f"filmed +1.90 body lengths per five cycles, over 3 cycles{f', {words}' * told}" in said
        assert (f"that of run 1, filmed +1.90, {words}" in said) == told and said.count(words) == 2 * told


def log(folder: Path, rig: Rig, design: Design, *events: str) -> Path:
    (folder / "run.mcap").unlink(missing_ok=True)
    with Recorder(folder / "run.mcap", [f"channel{c}" for c in range(1, 5)], []) as recorder:
        recorder.attach("schedule.json", json.dumps(schedule(rig, 3.0).to_json()).encode())
        recorder.attach("rig.yaml", (folder / "rig.yaml").read_bytes())
        recorder.attach("design.json", json.dumps(design.to_json()).encode())
        for event in events:
            recorder.on_event(40.0, event)
    return folder / "run.mcap"


def test_runs_of_other_robots_and_rigs_and_with_pauses_do_not_count(
    tmp_path: Path, rig: Rig, design: Design
) -> None:
    def read(log: Path, rig: Rig = rig) -> None:
        read_run(log, design, rig, lambda what, part: None)

    with raises(InputError, "adapt.paused", match=r"paused at 40\.0 s"):
        read(log(tmp_path, rig, design, "paused in cycle 2"))
    with raises(InputError, "dynamics.different-robots"):
        read(log(tmp_path, rig, replace(design, variant=Variant(ballast=Ballast(5.0, 0)))))
    with raises(InputError, "dynamics.different-rigs", match="a real rig; found a virtual one"):
        read(log(tmp_path, rig, design), rig.model_copy(update={"kind": "real"}))
    with raises(InputError, "log.no-positions"):
        read(log(tmp_path, rig, design))


def test_a_film_without_a_walk_is_no_run(
    tmp_path: Path, rig: Rig, design: Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No marker is seen at both ends of any cycle."""
    body = FilmedBody(design.morphology, design.marks)
    unknown = RobotFilms(body, [], nominal_robot(rig), (), design, [], {})
    monkeypatch.setattr(films, "read_films", lambda paths, design, progress: unknown)
    with raises(InputError, "film.lost", match="does not show how far the robot walked"):
        read_run(log(tmp_path, rig, design), design, rig, lambda what, part: None)


def test_springs_that_share_an_output_are_refused_before_they_are_heated(
    tmp_path: Path, rig: Rig, design: Design
) -> None:
    design.save(tmp_path / "design.json")
    shared = rig.model_copy(update={"supply": rig.supply.model_copy(update={"outputs": "shared"})})

    def drive(schedule: ActuationSchedule, log: Path) -> None:
        raise AssertionError("it heats")

    with raises(InputError, "rig.shared-output"):
        adapt(tmp_path / "design.json", shared, tmp_path / "out", drive)


def film_until_lost(folder: Path, rig: Rig, design: Design, lost: float, leans: bool) -> Path:
    """A log whose camera sees the robot stand, and no marker after `lost` [s]. One that falls sideways turns
    in no picture: its strips look shorter, and then none is seen."""
    body = design.morphology
    rest = body.positions * BuiltParameters().scale
    camera = VirtualCamera(3, FieldOfView.around(rest))
    path = folder / ("falls.mcap" if leans else "covered.mcap")
    files = {"schedule": schedule(rig, 1.0, period=10.0), "design": design, "tags": camera.board}
    with Recorder(path, [f"channel{c}" for c in range(1, 5)], []) as recorder:
        for name, value in files.items():
            recorder.attach(f"{name}.json", json.dumps(value.to_json()).encode())
        recorder.attach("rig.yaml", (folder / "rig.yaml").read_bytes())
        recorder.on_relays(0.0, [False] * 4)
        for t in (*np.arange(0.0, lost - 1.0, 1.0), *np.arange(lost - 1.0, lost + 3.0, 0.1)):
            shrink = np.cos(np.clip(t - lost + 0.4, 0.0, 0.4) * 2.0 * leans)
            there = rest * [1.0, shrink] if t <= lost else np.zeros((0, 2))
            springs, marks = (body.springs, design.marks) if t <= lost else (np.zeros((0, 2), int),) * 2
            recorder.on_frame(float(t), camera.render(there, springs, marks))
    return path


@pytest.mark.parametrize("leans", [True, False])
def test_a_robot_that_falls_sideways_did_not_stay_upright(
    tmp_path: Path, rig: Rig, design: Design, leans: bool
) -> None:
    """Nor did one that is covered, as far as the film shows; but that it fell is not said. Both stood for two
    cycles."""
    lost = schedule(rig, 1.0, period=10.0).start_of_cycles + 21.0
    run = open_run(film_until_lost(tmp_path, rig, design, lost, leans), design)
    seen = read_recording(run)
    assert seen.cycles == 2 and seen.fell_at == (pytest.approx(lost, abs=0.11) if leans else None)
    filmed = read_filmed_gait(run, seen)
    assert filmed is not None and not filmed.upright and filmed.has_fallen == leans
    assert seen.lost_at == filmed.lost_at_s == (None if leans else pytest.approx(lost, abs=0.11))
    end = ", and it fell" if leans else " over 2 cycles, lost at 34 s: fell, left the picture or was covered"
    assert filmed.summary.endswith(f"body lengths per five cycles{end}")
    rest = design.morphology.positions[design.marks] * BuiltParameters().scale
    assert find_any_fall(rest, seen) == seen.fell_at


def test_a_fall_sideways_in_the_second_cycle_is_a_run(tmp_path: Path, rig: Rig, design: Design) -> None:
    """Not a film that shows too little, after which the same gait would be heated again."""
    lost = schedule(rig, 1.0, period=10.0).start_of_cycles + 12.0

    def read(leans: bool) -> RobotFilms:
        film = film_until_lost(tmp_path, rig, design, lost, leans)
        return read_run(film, design, rig, lambda what, part: None)

    (fallen,) = read(leans=True).recordings
    assert fallen.cycles == 1 and fallen.fell_at == pytest.approx(lost, abs=0.11)
    with raises(InputError, "dynamics.too-few-cycles"):
        read(leans=False)


def test_a_prior_that_began_with_other_springs_is_refused(tmp_path: Path, rig: Rig, design: Design) -> None:
    """Its deviations would be added to the correction that was made of them. Supply and air may differ."""
    told = belief(design, rig, 0.3).scene
    told.save(tmp_path / BELIEF)
    nominal, tolerances = nominal_robot(rig), rig.spring_tolerances()

    def prior(**changes: float) -> PrintedScene:
        robot = RobotParameters(nominal.printed, replace(nominal.springs, **changes))
        return load_prior([tmp_path], robot, tolerances)

    with raises(InputError, "adapt.other-springs", match="another hot_length"):
        prior(hot_length=0.9 * nominal.springs.hot_length)
    with raises(InputError, "adapt.other-parameters"):  # which two parameters are not all: springs agree
        prior(current_limit=3.2, ambient=25.0)


@pytest.mark.parametrize("fell", [0, 3, 8])
def test_a_predicted_walk_tells_all_samples(fell: int) -> None:
    walks = np.concatenate([np.full(fell, -np.inf), np.random.default_rng(2).normal(1.0, 0.3, 8 - fell)])
    sampled = SampledWalks(walks)
    known = fell < 8
    told = PredictedWalk(
        samples=8, fell=fell, mean=sampled.mean if known else None, spread=sampled.spread if known else None
    )
    assert told.spread_with_falls == pytest.approx(sampled.spread_with_falls)
    assert told.expected == (pytest.approx(sampled.expected) if known else None)
