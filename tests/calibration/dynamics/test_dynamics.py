"""Identification from films: hidden parameters are found, and what cannot be known is said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from eldir.built.gait import Gait, free_lengths
from eldir.built.heat import SpringState, heat
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.built.samples import IdentifiedRobots, sample_walks
from eldir.built.scene import PrintedScene
from eldir.built.walking import displacements
from eldir.errors import InputError
from eldir.parameters.printed import STRIP_SPREAD
from eldir.parameters.robot import FOOT_SPREAD, QUANTITIES, contrasts, part_names, perturb_robot
from eldir.parameters.uncertain import PARAMETERS
from eldir.trajectory import Trajectory
from eldir_calibration.dynamics._fits import correlated_noise, fit_dynamics, frames_before_divergence
from eldir_calibration.dynamics._problem import Linearisation, Problem, Residual, compute_residual
from eldir_calibration.dynamics.recording import (
    Recording,
    predict_markers,
    require_explained,
    require_informative,
)
from eldir_calibration.dynamics.results import identify_robot
from eldir_calibration.dynamics.verdict import describe_model, within_noise
from tests.calibration.dynamics.hidden_rigs import QUICK, SOFT, film, hidden, unequal, walker
from tests.eldir.built.filmed_walker import TRUTH
from tests.paths import SCHEMAS
from tests.raised import raises

SCHEMA = json.loads((SCHEMAS / "built-scene.schema.json").read_text())


def test_hidden_parameters_are_found(scene: PrintedScene) -> None:
    found = scene.results.to_json()["quantities"]
    for name in ("hot_length", "cold_length", "current", "cooling", "friction"):
        true, told = QUANTITIES[name].value(TRUTH), found[name]
        assert told["value"] == pytest.approx(true, rel=0.05), name
        assert abs(told["nominal"] / true - 1) > 0.05, f"{name} has to be off for this to mean anything"
        assert told["identified"] and told["interval"][0] < told["value"] < told["interval"][1]
    held = scene.results.to_json()["held_out_cycle"]
    assert held["error_after"] < 0.05 and held["error_before"] > 3 * held["error_after"]


def test_what_landings_decide_is_left_out_of_the_fit(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A film that is nonsense where robots nearly the same part tells as much as the rest of it."""
    recording, names = recording.truncate(53.0), ("hot_length", "current")
    t = recording.tracked.times
    nonsense = 8e-3 * np.sin(t)[:, None, None] * (t > 45)[:, None, None] * np.ones((5, 2))
    nonsense[:, ::2] *= -1
    tumbles = replace(
        recording, tracked=replace(recording.tracked, positions=recording.tracked.positions + nonsense)
    )
    chance = Problem.divergence

    def parted(problem: Problem, z: np.ndarray, linear: Linearisation) -> list[Residual]:
        found = chance(problem, z, linear)
        for r, m in zip(problem.recordings, found, strict=True):
            m.shape[...] = np.where((r.tracked.times > 45)[:, None], 5e-3, m.shape)
        return found

    monkeypatch.setattr(Problem, "divergence", parted)
    fit = fit_dynamics(walker(), [tumbles], TRUTH.at(names, [-0.4, 0.3]), names, config=QUICK)
    assert within_noise(fit.check) and fit.check.excluded_s == (pytest.approx(t[-1] - 45, abs=2.5),)
    assert fit.z == pytest.approx([0.4, -0.3], abs=0.02)


def test_springs_that_differ_are_found_where_common_parameters_leave_something() -> None:
    body = walker()
    truth = unequal(body, SOFT, 1)
    seen = film(body, truth, 2, 2)
    quick = replace(QUICK, starts=1, part_rounds=(4,))
    scene = identify_robot(body, [seen], SOFT, names=("hot_length", "cold_length"), config=quick)
    told, model = scene.results.to_json(), scene.results.to_json()["model"]
    assert model["fits"] and model["parts"] and [c["fits"] for c in model["tried"]] == [False, True]
    found, springs = told["motor_springs"], scene.robot.motor_springs(2)
    for name in ("hot_length", "cold_length"):
        true = [getattr(s, name) for s in truth.motor_springs(2)]
        assert [getattr(s, name) for s in springs] == pytest.approx(found[name])
        assert np.abs(np.subtract(found[name], true)).max() < 0.25e-3 < np.abs(np.diff(true)) / 4, name
        low, high = told["quantities"][name]["interval"]
        assert low < np.mean(true) < high and told["quantities"][name]["identified"]
    assert "its own parameters" in describe_model(scene.results.model)[0]


def test_a_robot_is_its_parts() -> None:
    """Strips' lengths as in the drive of a robot with them; contrasts leave the springs' mean."""
    body, names = walker(), part_names(walker().morphology)
    strip = int(names[0].split()[1])
    turned = {names[0]: 2.0, "spring 1 cooling": 1.5}
    one = perturb_robot(
        body.morphology, SOFT, ("hot_length", *names), [1.0, *(turned.get(n, 0.0) for n in names)]
    )
    robot, plain = build(body.morphology, one), build(body.morphology, SOFT)
    assert np.flatnonzero(robot.rest_lengths != plain.rest_lengths).tolist() == [strip]
    assert robot.rest_lengths[strip] - plain.rest_lengths[strip] == pytest.approx(0.6e-3)
    hot = SOFT.at(["hot_length"], [1.0]).springs.hot_length
    assert [s.hot_length for s in one.motor_springs(2)] == pytest.approx([hot, hot])
    fans = np.log([s.convection_fan for s in one.motor_springs(2)])
    assert fans.mean() == pytest.approx(np.log(SOFT.springs.convection_fan)) and np.ptp(fans) > 0.1
    for motors in (1, 2, 5):
        apart = contrasts(motors)
        assert np.abs(apart @ apart.T / motors - np.eye(motors - 1)).max(initial=0) < 1e-12
        assert np.abs(apart.sum(axis=1)).max(initial=0) < 1e-12


def test_what_no_film_determines_is_named(scene: PrintedScene) -> None:
    quantities = scene.results.to_json()["quantities"]
    unknown = set(scene.results.not_identified)
    assert {"buckling", "printed_mass", "heat_capacity"} <= unknown
    for name in ("printed_mass", "heat_capacity"):
        assert quantities[name]["of_prior"] == pytest.approx(1, abs=1e-6), "a film told what it cannot"
        assert quantities[name]["value"] == pytest.approx(quantities[name]["nominal"], rel=1e-5)


def drawn_from(scene: PrintedScene) -> IdentifiedRobots:
    return IdentifiedRobots(
        walker().morphology, scene.robot, parameters=scene.parameters, covariance=scene.covariance
    )


def test_a_scene_is_kept_and_drawn_from(scene: PrintedScene, tmp_path: Path) -> None:
    scene.save(tmp_path / "scene.json")
    jsonschema.validate(json.loads((tmp_path / "scene.json").read_text()), SCHEMA)
    assert PrintedScene.load(tmp_path / "scene.json") == scene
    robots = drawn_from(scene)
    drawn = [robots.sample(np.random.default_rng(i)) for i in range(400)]
    hot = np.array([robot.springs.hot_length for robot in drawn])
    heavy = np.array([robot.printed.hexagon for robot in drawn])
    told = scene.results.to_json()["quantities"]["hot_length"]
    assert np.mean((hot > told["interval"][0]) & (hot < told["interval"][1])) == pytest.approx(0.95, abs=0.04)
    assert np.log(heavy).std() == pytest.approx(PARAMETERS["weight"].spread, rel=0.2)
    (tmp_path / "scene.json").write_text((tmp_path / "scene.json").read_text().replace('"weight"', '"wait"'))
    with raises(InputError, "built-scene.inconsistent", "parameters"):
        PrintedScene.load(tmp_path / "scene.json")


def test_a_prediction_is_what_the_engine_drives(recording: Recording) -> None:
    """Built and heated one by one, without the batch."""
    truth, body = hidden(2, SOFT), walker()
    short = recording.truncate(8.0)
    (found,) = predict_markers(body, [short], [SOFT, truth])
    for robot, x in zip((SOFT, truth), found, strict=True):
        built, springs = robot.printed, robot.springs
        history = heat(short.contact_shares, 0.05, springs, SpringState.cold(2, springs))
        lying = np.full((31, 2), springs.cold_length)  # for 1.5 s before the film
        free = (springs.cold_length, springs.hot_length)
        table = np.concatenate([lying, history.length])
        (alone,) = drive([build(body.morphology, built)], [table], 0.05, free=free)
        assert np.abs(x - alone.positions[30::2][: len(x), body.marker_masses]).max() < 1e-12


def test_a_prediction_knows_which_springs_pass_heat_to_each_other(recording: Recording) -> None:
    """Two robots whose two motors have one hub in common, each heated by itself."""
    at_a_hub = walker().morphology
    motors = np.flatnonzero((at_a_hub.springs == 3).any(axis=1))[:2]
    at_a_hub = replace(at_a_hub, active=np.isin(np.arange(len(at_a_hub.springs)), motors))
    short, body = recording.truncate(8.0), replace(walker(), morphology=at_a_hub)
    robots = [
        replace(SOFT, springs=replace(SOFT.springs, neighbour_conductance=value)) for value in (0.03, 0.01)
    ]
    (found,) = predict_markers(body, [short], robots)
    for robot, x in zip(robots, found, strict=True):
        springs = robot.springs
        state, hubs = SpringState.cold(2, springs), np.array([[0, 1], [1, 2]])
        history = heat(short.contact_shares, 0.05, springs, state, hubs=hubs)
        table = np.concatenate([np.full((31, 2), springs.cold_length), history.length])
        (alone,) = drive([build(at_a_hub, robot.printed)], [table], 0.05, free=robot.free_lengths)
        assert np.abs(x - alone.positions[30::2][: len(x), body.marker_masses]).max() < 1e-12
    assert np.abs(found[0] - found[1]).max() > 1e-5


def test_a_residual_ignores_where_marks_are_and_counts_a_slip_once(recording: Recording) -> None:
    rng = np.random.default_rng(0)
    apart = rng.standard_normal((*recording.tracked.positions.shape[:2], 2))
    once = compute_residual(recording, apart)
    glued = compute_residual(recording, apart + rng.standard_normal((apart.shape[1], 2)))
    assert np.abs(glued.shape - once.shape)[..., apart.shape[1] :].max() < 1e-9, "heights"
    slipped = apart.copy()
    slipped[300:, :, 0] += 1.0
    late = compute_residual(recording, slipped)
    assert np.abs(late.shape - once.shape).max() < 1e-9
    assert (np.abs(late.walk - once.walk) > 1e-9).sum() <= 2 and (
        late.walk - once.walk
    ).sum() == pytest.approx(1)


def blind(recording: Recording, marks: list[int]) -> Recording:
    x = recording.tracked.positions.copy()
    x[:, marks] = np.nan
    return replace(recording, tracked=Trajectory(recording.tracked.names, recording.tracked.times, x))


def test_logs_that_cannot_tell_are_refused(recording: Recording) -> None:
    still = replace(
        recording,
        tracked=replace(recording.tracked, positions=recording.tracked.positions * [1.0, 0.0]),
    )
    for log, code, found in (
        (still, "hardly-moves", r"found 0\.0 mm"),
        (blind(recording, [0, 1, 3, 4]), "too-few-marks", "found m3"),
        (blind(recording, [0, 1, 2, 3, 4]), "too-few-marks", "found none"),
        (replace(recording, contact_shares=0 * recording.contact_shares), "never-heated", None),
        (recording.truncate(45.0), "too-few-cycles", r"found \d$"),
    ):
        with raises(InputError, f"dynamics.{code}", match=found):
            require_informative([log])
    require_informative([recording])
    with raises(InputError, "dynamics.unexplained"):
        require_explained([recording], 10e-3)


def test_marks_in_another_order_are_not_explained(recording: Recording) -> None:
    """As where the design is another one, or marks were stuck on the wrong masses."""
    wrong = replace(
        recording,
        tracked=replace(recording.tracked, positions=recording.tracked.positions[:, ::-1]),
    )
    with raises(InputError, "dynamics.unexplained"):
        identify_robot(walker(), [wrong], SOFT, names=("hot_length", "friction"), config=QUICK)


def test_gaits_are_searched_and_judged_over_draws(scene: PrintedScene) -> None:
    """Robots drawn from the scene, by hand and by `sample_walks`: the same walks, not the nominal ones."""
    body, gait = walker().morphology, Gait(20.0, np.array([0.0, 0.875]), np.full(2, 0.3))
    (found,) = sample_walks(drawn_from(scene), [gait], 2, 5)
    robots, tables, free = [], [], []
    for i in range(2):
        rng = np.random.default_rng([5, i])
        values, vectors = np.linalg.eigh(scene.covariance)
        z = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values)))
        robot = scene.robot.at(scene.parameters, z)
        springs = robot.springs
        built = build(body, replace(robot.printed, geometry=STRIP_SPREAD), rng=rng)
        robots.append(replace(built, feet=np.exp(FOOT_SPREAD * rng.standard_normal(len(built.masses)))))
        tables.append(free_lengths(gait, springs))
        free.append((springs.cold_length, springs.hot_length))
    assert found.displacement.tolist() == displacements(robots, tables, 5, free).tolist()
    assert robots[0].rest_lengths.std() > robots[0].parameters.geometry / 2
    assert robots[0].parameters.tension != SOFT.printed.tension


def test_a_landing_in_the_first_frame_leaves_the_frames_that_none_decides():
    late, first, never = (np.array(k, bool) for k in ([1, 1, 0, 1], [0, 1, 1, 0], [0, 0, 0, 0]))
    assert [k.tolist() for k in frames_before_divergence([late, first])] == [
        [True, True, False, False],
        [False] * 4,
    ]
    (kept,) = frames_before_divergence([first])
    assert kept.tolist() == first.tolist()
    assert not frames_before_divergence([never])[0].any()


def test_noise_without_a_residual_is_that_of_chance():
    assert correlated_noise([np.zeros((5, 2))], [np.full((5, 2), 3.0)], 2) == pytest.approx(3.0)
    assert correlated_noise([np.zeros((5, 2))], [np.zeros((5, 2))], 2) == 0.0
