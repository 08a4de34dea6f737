"""An adaptation: its runs, folder, decisions after an interruption, and what the command says."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from scipy.integrate import quad
from scipy.stats import norm
from typer.testing import CliRunner

from eldir.built.gait_search import nominal_robots
from eldir.built.samples import IdentifiedRobots, sample_walks, simulate_most_probable
from eldir.built.scene import PrintedScene
from eldir.built.walking import describe_ties
from eldir.errors import EldirError, InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.uncertain import PARAMETERS
from eldir.terrain import Terrain
from eldir.trajectory import Trajectory
from eldir_app.application import application
from eldir_calibration.adaptation.choice import BestRun, advise_supply, discrepancy, expected_improvement
from eldir_calibration.adaptation.films import FilmedWalk, filmed_walks, nominal_robot, read_run
from eldir_calibration.adaptation.loop import adapt
from eldir_calibration.adaptation.page import RunRow, quantity_rows
from eldir_calibration.adaptation.runs import Adaptation, AdaptationConfig, AdaptationRun, Fault, SupplyAdvice
from eldir_calibration.dynamics.belief import Belief, BeliefConfig
from eldir_calibration.dynamics.recording import INTERVAL, FilmedBody, Recording, predict_markers
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.planning.compiler import extract_gait
from eldir_hardware.planning.plan import heating_limits
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule
from tests.calibration.adaptation.short_adaptation import FEW, make_walker, shorten
from tests.hardware.rigs_and_schedules import rig_text
from tests.paths import SCHEMAS
from tests.raised import raises

STEP = Terrain(np.array([-1.0, 0.06, 0.12]), np.array([0.0, 0.1, 0.0]), np.array([0.0, -0.006, 0.006]))
IMPOSSIBLE = "the coil of spring 2-3 would buckle on a printed robot, first 2.0 s after power-on"
OFF = {"hot_length": -0.8, "current": 0.5, "friction": 0.5}


class Bench:
    """A rig in a folder, and a robot on it whose parameters only this class knows. It walks as the engine
    says of a coarse robot, and its log holds tracks instead of pictures."""

    def __init__(self, folder: Path):
        self.folder, self.design_file, self.rig_file = folder, folder / "design.json", folder / "rig.yaml"
        self.design = make_walker()
        self.design.save(self.design_file)
        self.rig_file.write_text(rig_text(seed=4, design="design.json"))
        self.fails_in_run = 0
        self.is_cold = False
        self.off = OFF
        self.driven: list[str] = []
        self.decided: dict[str, bytes] = {}

    @property
    def rig(self) -> Rig:
        return Rig.load(self.rig_file)

    def adapt(self, out: str = "out", config: AdaptationConfig = FEW) -> Adaptation:
        return adapt(self.design_file, self.rig, self.folder / out, self.drive, config)

    def drive(self, schedule: ActuationSchedule, log: Path) -> None:
        self.driven.append(log.parent.name)
        if self.fails_in_run == int(log.parent.name[-2:]):
            log.write_bytes(b"the first records of a log")
            raise EldirError("the supply has failed")
        channels, states = schedule.sampled(INTERVAL)
        own = {entry.channel: entry.spring for entry in self.rig.channels}
        motors = [[channels.index(c) for c in channels if own[c] == m] for m in range(2)]
        on = np.stack([states[:, columns].mean(axis=1) for columns in motors], axis=1)
        names = tuple(f"m{i + 1}" for i in range(len(self.design.marks)))
        times = np.arange(0.0, len(on) * INTERVAL, 0.1)
        blank = Recording(Trajectory(names, times, np.zeros((len(times), len(names), 2))), on, 0.0, 1.0, 1)
        nominal = RobotParameters(BuiltParameters().with_hubs(), self.rig.spring_parameters())
        body = FilmedBody(self.design.morphology, self.design.marks, self.design.ballast / 2)
        moving = replace(blank, contact_shares=0.0 * on) if self.is_cold else blank
        truth = nominal.at(tuple(self.off), list(self.off.values()))
        (moved,) = predict_markers(body, [moving], [truth], coarse=True)[0]
        springs = [f"spring{entry.spring}_{entry.face}" for entry in self.rig.channels]
        with Recorder(log, [f"channel{c}" for c in range(1, 5)], springs) as recorder:
            recorder.attach("schedule.json", json.dumps(schedule.to_json()).encode())
            recorder.attach("rig.yaml", self.rig_file.read_bytes())
            recorder.attach("design.json", self.design_file.read_bytes())
            if log.parent.name == "run_02":
                recorder.on_status(0.0, "virtual rig", IMPOSSIBLE, good=False)
            recorder.on_relays(0.0, [False] * 4)
            closed = dict.fromkeys(range(1, 5), False)
            for t, changes in schedule.switchings():
                closed |= changes
                recorder.on_relays(t, list(closed.values()))
            for t, marks in zip(times, moved, strict=True):
                recorder.on_tracks(t, names, marks)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """After an adaptation whose second run failed, and which went on."""
    with pytest.MonkeyPatch.context() as shorter:  # how far it walks in the end is no matter here
        shorten(shorter.setattr)
        made = Bench(tmp_path_factory.mktemp("bench"))
        made.fails_in_run = 2
        with pytest.raises(EldirError, match="the supply has failed"):
            made.adapt()
        made.fails_in_run, made.decided = 0, files(made.folder / "out" / "run_02")
        made.adapt()
        yield made


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix == ".json"
    }


def test_every_run_is_kept_and_the_best_one_is_the_result(bench: Bench) -> None:
    out = bench.folder / "out"
    values = json.loads((out / "adaptation.json").read_text())
    jsonschema.validate(values, json.loads((SCHEMAS / "adaptation.schema.json").read_text()))
    found = Adaptation.load(out / "adaptation.json")
    assert [run.log for run in found.runs] == ["run_01/run_01.mcap", "run_02/run_02.mcap"]
    assert all((out / run.log).exists() and (out / run.schedule).exists() for run in found.runs)
    assert found.ended == "all runs are made (2)" and found.best is not None
    best = found.runs[found.best - 1]
    assert best.filmed == max(run.filmed for run in found.runs if run.upright)
    assert (out / "schedule.json").read_bytes() == (out / best.schedule).read_bytes()
    first, second = (ActuationSchedule.load(out / run.schedule) for run in found.runs)
    assert first.events != second.events and second.predicted.choice is not None
    assert found.runs[0].misfit is None and found.runs[1].misfit is not None
    before, after = PrintedScene.load(out / "run_02" / "belief.json"), PrintedScene.load(out / "belief.json")
    assert len(before.filmed_gaits) == 1 and len(after.filmed_gaits) == 2
    assert after.provenance["logs"] == ["run_01.mcap", "run_02.mcap"]
    assert after.provenance["misfit"] > 1.0, "eight members explain no film"
    assert found.heat is None and not found.advice, "such a belief tells nothing of heat and current"


def test_an_interrupted_adaptation_goes_on_with_the_same_decisions(bench: Bench) -> None:
    """No run is driven twice, the failed run's log is kept, and belief and schedule have the same bytes."""
    place = bench.folder / "out" / "run_02"
    assert bench.driven == ["run_01", "run_02", "run_02"]
    assert set(bench.decided) == {"belief.json", "schedule.json"} and files(place) == bench.decided
    assert (place / "interrupted_01.mcap").read_bytes() == b"the first records of a log"


def test_the_page_says_where_chance_decides_a_walk(bench: Bench) -> None:
    run = Adaptation.load(bench.folder / "out" / "adaptation.json").runs[0]
    schedule = ActuationSchedule.load(bench.folder / "out" / run.schedule)
    predicted, walk, method = schedule.predicted, schedule.predicted.walk, schedule.predicted.method
    assert walk is not None and method is not None

    def reason(tied: float) -> str:
        walks = predicted.displacement | {method: replace(walk, tie_share=tied)}
        changed = replace(predicted, displacement=walks)
        return RunRow(1, run, replace(schedule, predicted=changed), None, None, None).reason

    assert reason(0.4) == f"{reason(0.1)}; {describe_ties(0.4)}"


def test_the_page_shows_each_run_and_what_is_believed(bench: Bench) -> None:
    """Every number stands in the files beside it, and every link leads to one of them."""
    out = bench.folder / "out"
    found = Adaptation.load(out / "adaptation.json")
    page = (out / "adaptation.html").read_text()
    links = re.findall(r'(?:href|src)="(?!data:)([^"]+)"', page)
    assert {run.log for run in found.runs} <= set(links) and all((out / link).exists() for link in links)
    rows = re.findall(r"<tr(?: class=\"best\")?><td>(.+?)</tr>", page, re.DOTALL)
    for row, run in zip(rows, found.runs, strict=False):
        assert run.predicted is not None and run.deviation is not None
        low, high = (run.predicted + sign * 1.96 * run.deviation for sign in (-1, 1))
        assert f"{round(low, 2) + 0.0:+.2f} to {round(high, 2) + 0.0:+.2f}" in row
        assert f"{round(run.filmed, 2) + 0.0:+.2f}" in row
    assert f"Ended: {found.ended}." in page
    assert [run.impossible_motion for run in found.runs] == [None, IMPOSSIBLE]
    assert f"Run 2: not possible in reality: {IMPOSSIBLE}." in page
    belief = PrintedScene.load(out / "belief.json")
    nominal = nominal_robot(bench.rig)
    rows_by_name = {row.name: row for row in quantity_rows(nominal, None, belief)}
    assert not {"heat capacity", "resistivity", "printed mass"} & set(rows_by_name)
    friction, place = rows_by_name["friction"], belief.parameters.index("friction")
    assert friction.after == belief.built.friction and friction.before == nominal.printed.friction
    spread = PARAMETERS["friction"].spread
    assert np.log(friction.before_interval[1] / friction.before) == pytest.approx(1.96 * spread)
    assert friction.left == pytest.approx(np.sqrt(belief.covariance[place, place]))


def test_more_current_is_advised_only_where_the_springs_keep_the_limit(bench: Bench) -> None:
    """Whatever the rig file proves for its own springs. A current that is measured is what it should be."""
    place, rig = bench.folder / "out" / "run_01", bench.rig
    film = read_run(place / "run_01.mcap", bench.design, rig, lambda what, part: None)
    best = BestRun(ActuationSchedule.load(place / "schedule.json"), film)

    def advise(current: float, cooling: float = 0.0) -> dict[tuple[bool, float], SupplyAdvice]:
        """By whether the current is to be measured, and the warmest air; for a believed current."""
        z = np.array([current, cooling]) + 1e-3 * np.random.default_rng(1).standard_normal((8, 2))
        belief = Belief(nominal_robot(rig), film.body, ("current", "cooling"), z, 0.5)
        advice = advise_supply(bench.design, rig, best, (), belief.scene, belief, FEW)
        return {(one.current <= 0.02, one.ambient_max_c): one for one in advice}

    weak, exact, strong = (advise(z) for z in (-0.8, 0.0, 1.0))
    assert set(weak) == set(exact) == {(True, 30.0), (False, 25.0), (True, 25.0)}
    told = [*weak.values(), *exact.values()]
    assert all(one.current_limit_a > rig.supply.current_limit_a for one in told)
    assert not strong, "a quarter more than the supply is set to: no current that is allowed is more"
    for key in {(True, 30.0), (True, 25.0)}:
        same = {one[key].predicted for one in (weak, exact)}
        assert same == {None} or max(same) - min(same) < 0.02
    still = advise(-0.8, -1.0)[True, 25.0].current_limit_a
    assert still < weak[True, 25.0].current_limit_a, "springs that are cooled less get hotter"
    assert weak[False, 25.0].predicted != exact[False, 25.0].predicted


def test_runs_with_and_without_a_measured_current_do_not_share_a_folder(bench: Bench) -> None:
    rig = bench.rig
    measured = rig.model_copy(update={"tolerances": rig.tolerances.model_copy(update={"current": 0.02})})
    with raises(InputError, "dynamics.other-current", match="was not measured.*--prior"):
        read_run(bench.folder / "out/run_01/run_01.mcap", bench.design, measured, lambda what, part: None)


@pytest.mark.stress
def test_springs_that_are_too_hot_are_not_heated_again_before_the_current_is_lower(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A supply that gives a quarter more than it is set to."""
    shorten(monkeypatch.setattr)
    hot = Bench(tmp_path)
    hot.off = OFF | {"current": 1.0}
    text, own, config = (
        hot.rig_file.read_text(),
        hot.rig.supply.current_limit_a,
        replace(FEW, belief=BeliefConfig()),
    )
    found = hot.adapt(config=config)
    assert hot.driven == ["run_01"] and found.ended.startswith(
        "run 1: the springs get hotter than the limit of 90 C"
    )
    assert found.best is None and not (hot.folder / "out" / "schedule.json").exists()
    assert [fault.kind for fault in found.faults] == ["hot"] and found.heat is not None
    advised = re.search(r"current limit to ([\d.]+) A", found.faults[0].remedy)
    assert advised is not None and float(advised[1]) < own
    hot.rig_file.write_text(text.replace(f"current_limit_a: {own}", f"current_limit_a: {advised[1]}"))
    found = hot.adapt(config=config)
    assert hot.driven == ["run_01", "run_02"] and found.runs[1].current_limit_a == float(advised[1])
    assert found.heat is not None and found.heat.peak_c < 90.0


def test_the_time_is_up_before_anything_is_heated(bench: Bench) -> None:
    bench.driven.clear()
    found = bench.adapt("late", replace(FEW, minutes=0.0))
    assert found == Adaptation((), None, "the next run would end after 0 minutes") and not bench.driven
    assert not (bench.folder / "late").exists()


def test_the_time_is_up_while_a_person_puts_the_robot_back(bench: Bench) -> None:
    bench.driven.clear()
    now = [0.0]

    def ask(number: int, schedule: ActuationSchedule) -> None:
        assert number == 1 and schedule.duration < 600.0
        now[0] += 600.0

    found = adapt(
        bench.design_file,
        bench.rig,
        bench.folder / "slow",
        bench.drive,
        replace(FEW, minutes=10.0),
        ask=ask,
        clock=lambda: now[0],
    )
    assert found == Adaptation((), None, "the next run would end after 10 minutes") and not bench.driven


def test_with_another_current_the_error_of_earlier_films_counts(bench: Bench) -> None:
    """Until there is a film with this current. The robots are those of a supply that is set otherwise."""
    scene = PrintedScene.load(bench.folder / "out" / "run_02" / "belief.json")
    film, own = scene.filmed_gaits[0], bench.rig.supply.current_limit_a
    weaker = replace(scene.springs, current_limit=scene.springs.current_limit / 1.1)
    (walk,) = simulate_most_probable(
        IdentifiedRobots.of(bench.design, replace(scene, springs=weaker)), [film.gait], coarse=True
    )
    earlier = [FilmedWalk(film, own)]
    assert discrepancy(bench.design, scene, earlier, 1.1 * own) == pytest.approx(
        ((walk - film.walked) / 2, abs(walk - film.walked)), abs=2e-3
    )
    now = [*earlier, FilmedWalk(film, 1.1 * own)]
    assert discrepancy(bench.design, scene, now, 1.1 * own) == discrepancy(bench.design, scene, earlier, own)


def test_a_walk_is_compared_in_the_air_of_its_film(bench: Bench) -> None:
    """The belief holds for the air of the last run, and another run may have been in colder air."""
    scene = PrintedScene.load(bench.folder / "out" / "run_02" / "belief.json")
    film, own = scene.filmed_gaits[0], bench.rig.supply.current_limit_a
    colder = replace(scene.springs, ambient=scene.springs.ambient - 4.0)
    walks = [
        simulate_most_probable(IdentifiedRobots.of(bench.design, one), [film.gait], coarse=True)[0]
        for one in (scene, replace(scene, springs=colder))
    ]
    assert abs(walks[0] - walks[1]) > 0.02
    there, here = FilmedWalk(film, own, colder.ambient), FilmedWalk(film, own, scene.springs.ambient)
    for filmed, walk in ((here, walks[0]), (there, walks[1])):
        expected = (walk - film.walked) / 2, abs(walk - film.walked)
        assert discrepancy(bench.design, scene, [filmed], own) == pytest.approx(expected, abs=1e-6)
    bias, _ = discrepancy(bench.design, scene, [here, there], own)
    assert bias == pytest.approx((sum(walks) - 2 * film.walked) / 3, abs=1e-6)
    assert discrepancy(bench.design, scene, [here], own) == discrepancy(
        bench.design, scene, [FilmedWalk(film, own)], own
    )


def test_films_know_their_air(bench: Bench) -> None:
    out = bench.folder / "out"
    film = read_run(out / "run_01" / "run_01.mcap", bench.design, bench.rig, lambda what, part: None)
    for room, air in ((None, bench.rig.springs.ambient_c), (18.5, 18.5)):
        (walk,) = filmed_walks([film._replace(rooms_c=(room,))])
        assert walk.air_c == air and walk.current_limit_a == bench.rig.supply.current_limit_a


@pytest.mark.parametrize("with_prior", [False, pytest.param(True, marks=pytest.mark.stress)])
def test_the_first_run_is_planned_for_the_air_that_was_measured(bench: Bench, with_prior: bool) -> None:
    """Its walk is that of the samples in that air, with what another robot tells or without."""
    first, out = bench.folder / "out", bench.folder / f"cold_{with_prior}"
    planned: list[ActuationSchedule] = []

    def drive(schedule: ActuationSchedule, log: Path) -> None:
        planned.append(schedule)
        raise EldirError("nothing is driven")

    rig, prior = bench.rig, [first] if with_prior else []
    with pytest.raises(EldirError, match="nothing is driven"):
        adapt(bench.design_file, rig, out, drive, FEW, prior=prior, room_c=18.0)
    springs = replace(rig.spring_parameters(), ambient=18.0)
    robots = nominal_robots(bench.design, replace(heating_limits(rig), springs=springs))
    if with_prior:
        told = PrintedScene.load(out / "prior.json")
        assert told.springs.ambient == rig.springs.ambient_c, "it is that of all runs"
        colder = replace(told, springs=replace(told.springs, ambient=18.0))
        assert PrintedScene.load(out / "run_01" / "belief.json") == colder
        robots = IdentifiedRobots.of(bench.design, colder)
    (cold,) = planned
    gait, walk = extract_gait(cold), cold.predicted.walk
    assert gait is not None and walk is not None
    assert walk != ActuationSchedule.load(first / "run_01" / "schedule.json").predicted.walk
    (walks,) = sample_walks(robots, [gait], FEW.samples, FEW.seed)
    assert walk.mean == pytest.approx(walks.mean, abs=1e-6)


def test_one_film_tells_half_of_what_is_predicted_too_much(bench: Bench) -> None:
    out = bench.folder / "out"
    runs = Adaptation.load(out / "adaptation.json").runs
    scene = PrintedScene.load(out / "run_02" / "belief.json")
    (walk,) = simulate_most_probable(
        IdentifiedRobots.of(bench.design, scene), [scene.filmed_gaits[0].gait], coarse=True
    )
    films = [FilmedWalk(film, bench.rig.supply.current_limit_a) for film in scene.filmed_gaits]
    bias, error = discrepancy(bench.design, scene, films, bench.rig.supply.current_limit_a)
    assert bias == pytest.approx((walk - runs[0].filmed) / 2, abs=1e-4) and error == pytest.approx(
        abs(2 * bias)
    )
    planned = ActuationSchedule.load(out / runs[1].schedule).predicted.walk
    assert planned is not None and runs[1].predicted == pytest.approx(planned.expected - bias, abs=1e-4)


@pytest.mark.stress
def test_faults_of_earlier_runs_outlast_a_kill(bench: Bench) -> None:
    """Also one between the record of a run and what is learned from it."""
    copy = bench.folder / "faulty"
    shutil.copytree(bench.folder / "out", copy)
    known = Fault(1, "fall", "the robot falls at 43 s", "put ballast where the robot is low")
    replace(Adaptation.load(copy / "adaptation.json"), faults=(known,)).save(copy / "adaptation.json")

    def kill(number: int, run: AdaptationRun) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        adapt(bench.design_file, bench.rig, copy, bench.drive, replace(FEW, runs=3), on_run=kill)
    found = Adaptation.load(copy / "adaptation.json")
    assert len(found.runs) == 3 and known in found.faults


@pytest.mark.stress
def test_an_adaptation_that_is_complete_stays_as_it_is(bench: Bench) -> None:
    copy = bench.folder / "complete"
    shutil.copytree(bench.folder / "out", copy)
    bench.driven.clear()
    bench.adapt("complete")
    assert not bench.driven and files(copy) == files(bench.folder / "out")


@pytest.mark.stress
def test_a_run_that_was_played_but_not_recorded_counts(bench: Bench) -> None:
    """With the schedule that was played, whatever would be chosen now."""
    copy = bench.folder / "played"
    shutil.copytree(bench.folder / "out", copy)
    whole = Adaptation.load(copy / "adaptation.json")
    replace(whole, runs=whole.runs[:1], best=1, ended="", advice=()).save(copy / "adaptation.json")
    before = files(copy / "run_02")
    bench.driven.clear()
    found = bench.adapt("played", replace(FEW, min_gain=1e3))
    assert not bench.driven and len(found.runs) == 2 and files(copy / "run_02") == before


@pytest.mark.stress
def test_a_robot_that_never_moved_is_a_run_and_one_that_stops_moving_is_none(bench: Bench) -> None:
    """Its springs may be too cold, which is what the first film tells. After a film with motion the supply
    may be off: no belief comes from such a run, which is kept aside and repeated."""
    bench.is_cold = True
    still = bench.adapt("still", replace(FEW, runs=1))
    bench.is_cold = False
    assert [(fault.run, fault.kind) for fault in still.faults] == [(1, "cold")]
    assert still.faults[0].text.startswith("the robot hardly moves")
    assert still.heat is None and still.stands_still and still.runs[0].filmed == pytest.approx(0.0, abs=0.01)
    page = (bench.folder / "still" / "adaptation.html").read_text()
    assert still.faults[0].remedy in page and "Look for a marker that was lost" not in page
    bench.adapt("stops", replace(FEW, runs=1))
    bench.is_cold = True
    for again in (1, 2):
        with raises(InputError, "dynamics.hardly-moves"):
            bench.adapt("stops")
        kept = sorted(path.name for path in (bench.folder / "stops" / "run_02").glob("*.mcap"))
        assert kept == [f"interrupted_{k:02d}.mcap" for k in range(1, again + 1)]
    bench.is_cold = False
    assert len(Adaptation.load(bench.folder / "stops" / "adaptation.json").runs) == 1


@pytest.mark.stress
def test_it_ends_when_no_gait_is_worth_a_run(bench: Bench) -> None:
    copy = bench.folder / "worth"
    shutil.copytree(bench.folder / "out", copy)
    bench.driven.clear()
    found = bench.adapt("worth", replace(FEW, runs=3, min_gain=1e3))
    assert not bench.driven and len(found.runs) == 2
    assert found.ended.startswith("no gait is expected to walk farther than")


@pytest.mark.stress
def test_the_supply_may_be_turned_up_between_runs_but_springs_stay(bench: Bench) -> None:
    """A film with the old current counts; its gait is another one with the new current."""
    copy, text = bench.folder / "supply", bench.rig_file.read_text()
    shutil.copytree(bench.folder / "out", copy)
    own = bench.rig.supply.current_limit_a
    bench.rig_file.write_text(text.replace(f"current_limit_a: {own}", "current_limit_a: 3.3"))
    try:
        found = bench.adapt("supply", replace(FEW, runs=3))
        assert [run.current_limit_a for run in found.runs] == [own, own, 3.3]
        scene = PrintedScene.load(copy / "run_03" / "belief.json")
        assert found.runs[2].deviation is not None and found.runs[2].deviation > 0.0
        assert not scene.filmed_gaits and scene.provenance["logs"] == ["run_01.mcap", "run_02.mcap"]
        assert (
            scene.springs.current_limit
            < PrintedScene.load(copy / "run_02" / "belief.json").springs.current_limit
        )
        bench.rig_file.write_text(text.replace("resistance_ohm: 0.987", "resistance_ohm: 0.9"))
        with raises(InputError, "dynamics.different-rigs", match="run_01.mcap"):
            bench.adapt("supply", replace(FEW, runs=4))
    finally:
        bench.rig_file.write_text(text)


@pytest.mark.parametrize(("mean", "deviation", "best"), [(1.0, 0.3, 0.9), (0.5, 0.4, 1.2), (1.5, 0.1, 1.0)])
def test_the_expected_improvement_is_its_integral(mean: float, deviation: float, best: float) -> None:
    def improvement(walk: float) -> float:
        return float((walk - best) * norm.pdf(walk, mean, deviation))

    expected, _ = quad(improvement, best, mean + 10 * deviation)
    assert expected_improvement(mean, deviation, best) == pytest.approx(expected, rel=1e-6)
    assert expected_improvement(mean, 0.0, best) == max(0.0, mean - best)
    assert expected_improvement(-np.inf, deviation, best) == 0.0


def test_what_cannot_be_adapted_is_refused_before_anything_is_heated(bench: Bench, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    command = ["adapt", str(bench.design_file), "--rig", str(bench.rig_file), "--out"]
    result = CliRunner().invoke(application(), [*command, str(folder)])
    assert isinstance(result.exception, EldirError) and result.exception.code == "adapt.other-folder"
    result = CliRunner().invoke(application(), [*command, str(tmp_path / "new"), "--room", "50"])
    assert isinstance(result.exception, EldirError) and result.exception.code == "limit.room"
    killed = tmp_path / "killed"  # while it wrote its first file
    killed.mkdir()
    (killed / ".prior.json.x3k1").touch()
    result = CliRunner().invoke(application(), [*command, str(killed), "--room", "50"])
    assert isinstance(result.exception, EldirError) and result.exception.code == "limit.room"
    blind = tmp_path / "rig.yaml"
    blind.write_text(yaml.safe_dump({**yaml.safe_load(bench.rig_file.read_text()), "camera": None}))
    blinded = ["adapt", str(bench.design_file), "--rig", str(blind), "--out", str(tmp_path / "new")]
    result = CliRunner().invoke(application(), blinded)
    assert isinstance(result.exception, EldirError) and result.exception.code == "adapt.no-camera"
    on_ground = replace(bench.design, printed_terrain=STEP)
    on_ground.save(tmp_path / "design.json")
    with raises(InputError, "dynamics.terrain"):
        adapt(tmp_path / "design.json", bench.rig, tmp_path / "new", bench.drive)
    replace(bench.design, kept_marks=tuple(bench.design.marks[:2].tolist())).save(tmp_path / "design.json")
    with raises(InputError, "adapt.too-few-marks", match="found 2"):
        adapt(tmp_path / "design.json", bench.rig, tmp_path / "new", bench.drive)
    assert not (tmp_path / "new").exists()
