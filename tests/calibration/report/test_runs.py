"""Several robots in one report, and what agreement is worth against other bodies."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from eldir.controller import Controller
from eldir.design import Design
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.scene import Scene
from eldir.trajectory import Trajectory
from eldir_calibration.report.comparison import Motion, agreements
from eldir_calibration.report.controls import (
    INTACT,
    OTHER_COUNT,
    FilmedRun,
    compare_with_others,
    pool_displacements,
    sample_other_robots,
    summarise_controls,
)
from eldir_calibration.report.page import write_report
from eldir_hardware.camera.plane import Plane
from eldir_hardware.vision.tracking_quality import TrackingQuality
from tests.calibration.report.report_input import SCHEMA, content
from tests.calibration.report.striding_walkers import CYCLES, LENGTH, walker
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_with

INTACT_RUN = FilmedRun("a.mcap", INTACT, "", walker(speed=0.03, noise=1e-4), walker(speed=0.028))
WITHOUT = FilmedRun(
    "b.mcap", "without a motor", "without motor 1", walker(noise=1e-4, speed=0.001), walker(speed=0)
)
BALLAST = FilmedRun(
    "c.mcap", "without a motor, with ballast", "without motor 1, with 9 g on mass 4",
    walker(speed=-0.016, noise=1e-4), walker(speed=-0.01),
)  # fmt: skip
RUNS = (INTACT_RUN, WITHOUT, BALLAST)


def test_a_cycles_displacement_is_its_own() -> None:
    """Forward in the first three cycles only."""
    motion = walker(speed=0.0)
    x = motion.trajectory.positions.copy()
    x[:, :, 0] += 0.02 * np.clip((motion.trajectory.times - motion.start) / motion.period, 0, 3)[:, None]
    track = Trajectory(("m1", "m2"), motion.trajectory.times, x)
    stopped = Motion(track, motion.start, motion.period, CYCLES, LENGTH)
    expected = 5 * 0.02 / LENGTH * np.array([1, 1, 1, 0, 0])
    np.testing.assert_allclose(stopped.displacements(), expected, atol=1e-6)
    assert stopped.displacement() == pytest.approx(expected.mean())


def test_runs_of_one_robot_count_together() -> None:
    again = FilmedRun("d.mcap", INTACT, "", walker(speed=0.034, noise=1e-4), walker())
    both = pool_displacements([*RUNS, again])
    assert list(both) == [INTACT, "without a motor", "without a motor, with ballast"]
    assert both[INTACT].mean == pytest.approx(5 * 0.032 / LENGTH, abs=0.01)
    assert both[INTACT].low < 5 * 0.032 / LENGTH < both[INTACT].high
    assert again.predicted_displacement == pytest.approx(5 * 0.01 / LENGTH)


def test_the_verdict_is_as_sure_as_the_intervals() -> None:
    said = summarise_controls(RUNS)
    assert len(said) == 2 and all("they differ" in line and "overlap" not in line for line in said)
    uncertain = FilmedRun("b.mcap", "without a motor", "", walker(speed=0.0301, noise=2e-3), walker())
    assert "do not distinguish them" in summarise_controls([INTACT_RUN, uncertain])[0]
    short = replace(WITHOUT, tracked=replace(WITHOUT.tracked, cycles=1))
    assert summarise_controls([INTACT_RUN, short])[0].startswith("It is unknown whether the robot without")
    assert summarise_controls([INTACT_RUN]) == [] and summarise_controls([WITHOUT]) == []


def _runs(robot: str, *walks: float, error: float = 0.0) -> list[FilmedRun]:
    """Runs of one robot that walk so far [body lengths per five cycles], each of five equal cycles but for
    noise."""
    return [
        FilmedRun(
            "a.mcap", robot, "", walker(speed=walk * LENGTH / 5, noise=1e-5), walker(), film_error=error
        )
        for walk in walks
    ]


def test_cycles_of_one_run_are_no_independent_runs() -> None:
    """Two runs of each robot: Student's t with one degree of freedom is 12.71."""
    runs = [*_runs(INTACT, 0.9, 1.5), *_runs("without a motor", 0.55, 0.75)]
    together = pool_displacements(runs)
    for kind, mean, half in ((INTACT, 1.2, 12.706 * 0.3), ("without a motor", 0.65, 12.706 * 0.1)):
        found = together[kind]
        assert (found.mean, found.low, found.high) == pytest.approx(
            (mean, mean - half, mean + half), abs=0.01
        )
    assert "do not distinguish them" in summarise_controls(runs)[0]
    many = [*_runs(INTACT, 1.1, 1.2, 1.3), *_runs("without a motor", 0.5, 0.6)]
    assert "do not distinguish them" in summarise_controls(many)[0], "0.55 +- 0.64"
    alike = [*_runs(INTACT, 1.1, 1.2, 1.3), *_runs("without a motor", 0.5, 0.55, 0.6)]
    assert summarise_controls(alike)[0].endswith(": they differ.")
    single = [*_runs(INTACT, 1.1, 1.2, 1.3), *_runs("without a motor", 0.5)]
    assert summarise_controls(single)[0].endswith(": they differ in these runs.")


def test_runs_that_were_heated_otherwise_do_not_count_together() -> None:
    runs = _runs(INTACT, 1.1, 1.2, 1.3)
    apart = replace(_runs(INTACT, 1.9)[0], other_heating="other pulses")
    assert pool_displacements([*runs, apart])[INTACT] == pool_displacements(runs)[INTACT]
    control = _runs("without a motor", 0.5)[0]
    assert "they differ" in summarise_controls([*runs, control])[0]
    (told,) = summarise_controls([*runs, replace(control, other_heating="other pulses")])
    assert told == (
        "The robot without a motor was heated otherwise than the intact one, so their walks are not compared."
    )


def test_a_page_averages_runs_of_one_heat(tmp_path) -> None:
    """No line for a robot of which one run counts."""
    first, again = _runs(INTACT, 1.0, 1.4)
    apart, control = replace(again, other_heating="other pulses"), _runs("without a motor", 0.5)[0]
    rows = {}
    for name, runs in {
        "alike": (first, again),
        "apart": (first, again, apart),
        "one": (first, apart, control),
    }.items():
        write_report(content(runs=runs), tmp_path / name)
        rows[name] = re.findall(
            r"<tr><td>(all runs|runs heated alike)</td>\s*<td>([^<]*)</td>\s*<td>([^<]*)<",
            (tmp_path / name / "index.html").read_text(),
        )
    assert rows == {
        "alike": [("all runs", INTACT, "+1.20")],
        "apart": [("runs heated alike", INTACT, "+1.20")],
        "one": [],
    }


def test_a_run_without_markers_does_not_count() -> None:
    unseen = _runs(INTACT, 1.0)[0]
    unseen.tracked.trajectory.positions.setflags(write=True)
    unseen.tracked.trajectory.positions[:] = np.nan
    (seen,) = _runs(INTACT, 1.2)
    assert pool_displacements([unseen, seen]) == {INTACT: seen.displacement}
    assert np.isnan(pool_displacements([unseen, unseen])[INTACT].mean)


def test_a_robot_that_left_its_plane_is_less_surely_another() -> None:
    """Films that are 0.4 apart, each of which may be wrong by 0.3."""
    flat, left = (
        [*_runs(INTACT, 1.0, error=error), *_runs("without a motor", 0.6, error=error)]
        for error in (0.0, 0.3)
    )
    assert "they differ in these runs" in summarise_controls(flat)[0]
    assert "do not distinguish them" in summarise_controls(left)[0]
    assert left[0].displacement.low == pytest.approx(flat[0].displacement.low - 0.3)
    pooled = [pool_displacements(_runs(INTACT, 1.0, 1.1, error=error))[INTACT] for error in (0.0, 0.3)]
    assert pooled[1].high == pytest.approx(pooled[0].high + 0.3)


def test_other_bodies_fit_less_than_the_own() -> None:
    tracked = walker(noise=1e-5)
    shifted = [walker(phase=p) for p in (0.25, 0.5)]
    found = compare_with_others({"predicted": walker(lift=0.0031)}, tracked, shifted)
    assert found.count == 2 and len(found.body_lengths_per_5_cycles_of_others) == 2
    assert np.isnan(found.profile_correlation["predicted"]), "two masses have no profile"
    for mass in found.correlation_of_others.values():
        assert mass["vertical"] == pytest.approx(0.5, abs=0.02)  # 0 at a quarter, 1 at a half
    assert found.body_lengths_per_5_cycles_of_others[0] == pytest.approx(5 * 0.01 / LENGTH)


def test_the_rank_is_the_share_of_phases_that_fit_as_well() -> None:
    own = agreements(walker().by_phase(), walker().by_phase())
    assert own[0]["vertical"].rank == pytest.approx(0.01)
    off = agreements(walker(phase=0.25).by_phase(), walker().by_phase())
    assert off[0]["vertical"].rank == pytest.approx(0.5, abs=0.02)


def test_other_robots_have_as_many_motors_and_five_marks() -> None:
    lattice = Lattice(6, 11)
    body = random_genotypes(lattice, 1, np.random.default_rng(3), 2)[0]
    robot = develop(lattice, body)
    controller = Controller.random(len(robot.positions), robot.motors, np.random.default_rng(0))
    design = Design(lattice, body, controller, Scene.preset("paper"))
    first, second = sample_other_robots(design), sample_other_robots(design)
    assert len(first) == OTHER_COUNT
    for (a, marks), (b, _) in zip(first, second, strict=True):
        assert a == b and a.active.sum() == robot.motors and len(marks) == 5


def test_other_robots_have_the_joints_and_springs_of_the_rig() -> None:
    """Wire of 0.7 mm instead of 0.75 is less stiff by its fourth power; the kit's springs change no digit."""
    design = make_design(3, Lattice(3, 6))
    soft = {"wire_diameter_mm": 0.7, "resistance_ohm": 1.18}
    rigs = [rig_with(), rig_with(springs=soft, supply={"current_limit_a": 3.0})]
    real = rigs[0].model_copy(update={"kind": "real"})
    kit, own, wired, hubs = (
        sample_other_robots(design, *args)
        for args in ((), *((rig.nominal_robot(),) for rig in (*rigs, real)))
    )
    for (a, _), (b, _), (c, _), (d, _) in zip(kit, own, wired, hubs, strict=True):
        np.testing.assert_array_equal(a.stiffness, b.stiffness)
        np.testing.assert_array_equal(a.masses, b.masses)
        np.testing.assert_allclose(c.stiffness[c.active] / a.stiffness[a.active], (0.7 / 0.75) ** 4)
        assert d.parameters.joints == "hubs" != a.parameters.joints


def test_controls_nulls_and_tracking_are_in_page_and_numbers(tmp_path: Path) -> None:
    tracked = INTACT_RUN.tracked
    sizes = np.ones((len(tracked.trajectory.times), 2))
    quality = TrackingQuality.of(tracked.trajectory, sizes, 0.1, 1, 2, 0.1)
    plane = Plane(640, 480, np.diag([2.0, -2, 1]), [320, 240], [0, 0], 0.1)
    others = compare_with_others({"simulated": walker(), "predicted": walker()}, tracked, [walker(phase=0.3)])
    report = content(
        tracked=tracked, predicted=INTACT_RUN.predicted, runs=RUNS, others=others, quality=quality,
        frame=np.full((480, 640, 3), 120, np.uint8), plane=plane,
    )  # fmt: skip
    write_report(report, tmp_path / "report")
    values = json.loads((tmp_path / "report" / "report.json").read_text())
    jsonschema.validate(values, SCHEMA)
    assert [run["robot"] for run in values["runs"]] == [run.robot for run in RUNS]
    low, high = values["body_lengths_per_5_cycles_interval"]["tracked"]
    assert low < values["body_lengths_per_5_cycles"]["tracked"] < high
    assert values["tracking"]["repeated_pictures"] == 2
    assert values["other_designs"]["count"] == 1
    page = (tmp_path / "report" / "index.html").read_text()
    for text in (
        "without motor 1, with 9 g on mass 4",
        "-0.40",
        "duplicate pictures",
        "other bodies",
        "@media print",
    ):
        assert text in page
    pictures = {p.stem for p in (tmp_path / "report").glob("*.png")}
    assert {"runs", "cycles"} <= pictures
    # all markers of these walkers rise alike: their profiles have no correlation
    assert "profiles" not in pictures and "Not drawn: correlation of profiles: none is known" in page
    write_report(report, tmp_path / "again")
    for path in (tmp_path / "again").iterdir():
        assert path.read_bytes() == (tmp_path / "report" / path.name).read_bytes(), path.name
