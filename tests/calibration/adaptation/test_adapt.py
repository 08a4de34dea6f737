"""An adaptation: its runs, folder, decisions after an interruption, and what the command says."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from scipy.integrate import quad
from scipy.stats import norm
from typer.testing import CliRunner

from eldir.built.scene import PrintedScene
from eldir.built.walking import describe_ties
from eldir.errors import EldirError, InputError
from eldir.parameters.uncertain import PARAMETERS
from eldir.terrain import Terrain
from eldir_app.application import application
from eldir_calibration.adaptation.choice import BestRun, advise_supply, expected_improvement
from eldir_calibration.adaptation.films import nominal_robot, read_run
from eldir_calibration.adaptation.loop import adapt
from eldir_calibration.adaptation.page import RunRow, quantity_rows
from eldir_calibration.adaptation.runs import Adaptation, AdaptationRun, Fault, SupplyAdvice
from eldir_calibration.dynamics.belief import Belief, BeliefConfig
from eldir_hardware.log.mcap_file import fingerprint
from eldir_hardware.schedule import ActuationSchedule
from tests.calibration.adaptation.hidden_bench import IMPOSSIBLE, OFF, Bench, files
from tests.calibration.adaptation.short_adaptation import FEW, shorten
from tests.paths import SCHEMAS
from tests.raised import raises

STEP = Terrain(np.array([-1.0, 0.06, 0.12]), np.array([0.0, 0.1, 0.0]), np.array([0.0, -0.006, 0.006]))


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
    assert after.provenance["fingerprints"] == [fingerprint(out / run.log) for run in found.runs]
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
    told = re.search(r"the limit of the rig file the films tell\s+([\d.]+) A \(([\d.]+) to ([\d.]+)\)", page)
    assert (told is None) == (not found.advice)
    assert told is None or float(told[2]) < float(told[1]) < float(told[3])
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
    assert hot.driven == ["run_01"]
    assert re.match("run 1: the springs (may )?get hotter than the limit of 90 C", found.ended)
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
