"""Identification from films: hidden parameters are found, and what cannot be known is said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from eldir.built.gait import Gait, free_lengths
from eldir.built.heat import SpringState, heat
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.built.samples import IdentifiedRobots, sample_walks
from eldir.built.scene import IdentifiedModel, ModelNumbers, PrintedScene
from eldir.built.walking import displacements
from eldir.errors import InputError
from eldir.parameters.printed import STRIP_SPREAD
from eldir.parameters.robot import FOOT_SPREAD, QUANTITIES, contrasts, part_names, perturb_robot
from eldir.parameters.uncertain import PARAMETERS
from eldir.trajectory import Trajectory
from eldir_calibration.dynamics._fits import (
    DynamicsFit,
    correlated_noise,
    fit_dynamics,
    frames_before_divergence,
)
from eldir_calibration.dynamics._model_check import ModelCheck, check_model, track_noise
from eldir_calibration.dynamics._model_search import CandidateModel
from eldir_calibration.dynamics._problem import Linearisation, Problem, Residual, compute_residual
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.dynamics.recording import (
    Recording,
    predict_markers,
    require_explained,
    require_informative,
)
from eldir_calibration.dynamics.results import identify_robot, summarise
from eldir_calibration.dynamics.verdict import FitVerdict, describe_model, within_noise
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


def model_of(check: ModelCheck) -> IdentifiedModel:
    """The only joint model that was tried, with this check of its fit."""
    told = {
        "strips": "pinned", "parts": False, "supposed": True, "at_edge": (), "held_out_left_m": 1e-3,
        "held_out_unexplained_m": 1e-3, "fits": False, "predicts": False, **check.entries(),
    }  # fmt: skip
    return alone(told)


def alone(entries: dict[str, Any]) -> IdentifiedModel:
    """The only joint model that was tried."""
    return IdentifiedModel(**entries, tried=(ModelNumbers(**entries),))


def test_a_model_that_fits_is_distinguished_from_one_that_does_not(
    recording: Recording, scene: PrintedScene
) -> None:
    model = scene.results.model
    assert model.fits and not model.parts and len(model.tried) == 1 and not describe_model(model)
    assert track_noise(recording) == pytest.approx(0.15e-3, rel=0.15)
    rng, t = np.random.default_rng(3), recording.tracked.times
    still = np.zeros((len(t), 5, 2)) + recording.tracked.positions * 0
    exact = replace(recording, tracked=replace(recording.tracked, positions=still))
    noise = 0.15e-3 * rng.standard_normal(still.shape)
    noisy = replace(exact, tracked=replace(exact.tracked, positions=still + noise))
    bent = noisy.tracked.positions.copy()
    bent[:, 3, 1] += 0.4e-3 * np.sin(t)
    assert within_noise(check_model([noisy], [np.zeros_like(noise)]))
    bending = replace(noisy, tracked=replace(noisy.tracked, positions=bent))
    found = check_model([bending], [np.zeros_like(noise)])
    assert not within_noise(found) and found.correlated[1, 3] == pytest.approx(0.4e-3 / np.sqrt(2), rel=0.05)
    assert found.noise == pytest.approx(0.15e-3, rel=0.1), "a mark's motion is no noise"
    told = model_of(found)
    (said,) = describe_model(told)
    assert "does not fit" in said and "most in m4 up 0.2" in said


def test_chance_hides_no_wrong_model(recording: Recording) -> None:
    """Robots nearly the same part at an instant; what is left before it counts, and nothing after it."""
    t, rng = recording.tracked.times, np.random.default_rng(4)
    noise = 0.15e-3 * rng.standard_normal((len(t), 5, 2)) + recording.tracked.positions * 0
    film = replace(recording, tracked=replace(recording.tracked, positions=noise))
    parted = 3e-3 * rng.standard_normal((7, 1, 10)) * (2 + np.sin(t)[:, None])
    smooth = 0.4e-3 * np.sin(t)[:, None, None] * np.ones((5, 2))

    def judged(wrong: np.ndarray, chance: np.ndarray) -> ModelCheck:
        return check_model([film], [smooth * wrong[:, None, None]], [parted * chance[:, None]])

    never, always = t < 0, t >= 0
    found = judged(never, t > 50)
    assert within_noise(found) and found.excluded_s == (pytest.approx(t[-1] - 50, abs=1.5),)
    assert not within_noise(judged(always, t > 50)), "millimetres of chance hid what was left before"
    assert judged(t > 52, t > 50).unexplained < 0.05e-3, "what is left after they parted was counted"
    assert judged(never, never).excluded_s == (0.0,) and within_noise(judged(never, (t > 30) & (t < 32)))
    early = judged(never, t > 39)
    assert early.unexplained < early.limit < 0.15e-3 and not early.is_decidable and not within_noise(early)
    nothing = judged(never, always)
    assert not within_noise(nothing) and nothing.unexplained == 0 and not nothing.reproducible[0].any()
    told = model_of(early)
    first, second = describe_model(told)
    assert "left out: " in first and "s of film 1" in first and "too few frames are left" in second


def test_a_film_of_which_nothing_is_left_says_nothing_about_noise(recording: Recording) -> None:
    positions = recording.tracked.positions
    nothing = replace(recording, tracked=replace(recording.tracked, positions=positions * np.nan))
    assert np.isnan(track_noise(nothing))
    still = [np.zeros_like(positions), np.zeros_like(positions) * np.nan]
    found = check_model([recording, nothing], still)
    assert found.noise == pytest.approx(track_noise(recording))


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


def test_a_model_that_does_not_fit_knows_nothing(recording: Recording, scene: PrintedScene) -> None:
    """However narrow the curvature: an interval reaches back to where the parameter was moved from."""
    left = 0.5e-3 * np.sin(recording.tracked.times)[:, None, None] * np.ones((5, 2))
    wrong = check_model([recording], [recording.tracked.positions - left])
    right = check_model([recording], [recording.tracked.positions - 1e-3 * left])
    z, narrow = np.array([2.0]), np.array([[1e-4]])
    for fits, unseen, known in ((wrong, right, False), (right, wrong, False), (right, right, True)):
        fit = DynamicsFit(("hot_length",), z, narrow, (1e-4, 1e-4), (1e-4, 1e-4), 1.0, 1, z, fits)
        best = CandidateModel(SOFT, fit, unseen)
        told = summarise(best, [best], walker(), recording).to_json()
        assert told["model"]["fits"] == known == (not told["not_identified"])
        assert best.verdict.fits == known
        low, high = told["quantities"]["hot_length"]["interval"]
        assert (low < SOFT.springs.hot_length < high) != known
        assert best.covariance(["hot_length"]).tolist() == ([[1e-4]] if known else [[5.0]])
    chosen = summarise(replace(best, assumed=False), [best], walker(), recording)
    assert chosen.model.fits and chosen.not_identified == ("hot_length",)
    assert "the film chose" in describe_model(chosen.model)[-1]
    assert replace(best, assumed=False).covariance(["hot_length"]).tolist() == [[5.0]], "as the prior"


def test_a_model_of_every_part_may_leave_little(recording: Recording) -> None:
    """Two per cent of the motion, in what it was shown and in what not; one of like parts nothing."""
    shape = compute_residual(recording, np.nan_to_num(recording.tracked.positions)).shape
    motion = float(np.sqrt((shape[shape != 0] ** 2).mean()))
    wave = motion * np.sin(3 * recording.tracked.times)[:, None, None] * np.ones((5, 2))
    wave[..., 0] *= np.array([-1, 1, -1, 1, 0])  # nothing in common, which is the walk
    little, more = (check_model([recording], [recording.tracked.positions - s * wave]) for s in (0.015, 0.05))
    assert little.motion == pytest.approx(motion) and not within_noise(little)
    assert 0.005 * motion < little.unexplained < 0.02 * motion < more.unexplained
    strip, z = part_names(walker().morphology)[0], np.array([2.0, 0.0])
    for names, shown, unseen, nearly in (
        (("hot_length", strip), little, little, True),
        (("hot_length", strip), more, little, False),
        (("hot_length", strip), little, more, False),
        (("hot_length", "friction"), little, little, False),
    ):
        fit = DynamicsFit(names, z, 1e-4 * np.eye(2), (1e-4, 1e-4), (1e-4, 1e-4), 1.0, 1, z, shown)
        best = CandidateModel(SOFT, fit, unseen)
        told = best.entries()
        assert best.verdict.fits == told["fits"] == nearly
        if nearly:
            (said,) = describe_model(alone(told))
            assert "nearly right" in said and "% of the motion" in said
            assert best.covariance(["hot_length"]) == pytest.approx(4e-4), "twice as wide"
            strained = replace(best, fit=replace(fit, z=np.array([DEFAULT_CONFIG.z_limit, 0.0])))
            told = strained.entries()
            assert strained.verdict is FitVerdict.AT_EDGE and told["at_edge"] == ("hot_length",)
            (said,) = describe_model(alone(told))
            assert "hot_length reached the edge" in said
            worse = replace(strained, fit=replace(strained.fit, check=more)).entries()
            both = describe_model(alone(worse))
            assert len(both) == 2 and "does not fit" in both[1]
            assert strained.covariance(["hot_length"]).tolist() == [[10.0]]
            assert strained.prediction_covariance(["hot_length"]) == pytest.approx(4e-4), (
                "it moves like the robot"
            )


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
