"""Whether a model fits: what it leaves of the film against the film's noise, chance and motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eldir.built.scene import IdentifiedModel, ModelNumbers, PrintedScene
from eldir.parameters.robot import part_names
from eldir_calibration.dynamics._fits import DynamicsFit
from eldir_calibration.dynamics._model_check import ModelCheck, check_model, track_noise
from eldir_calibration.dynamics._model_search import CandidateModel
from eldir_calibration.dynamics._problem import compute_residual
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.dynamics.recording import Recording
from eldir_calibration.dynamics.results import summarise
from eldir_calibration.dynamics.verdict import FitVerdict, describe_model, within_noise
from tests.calibration.dynamics.hidden_rigs import SOFT, walker


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

    def judge(wrong: np.ndarray, chance: np.ndarray) -> ModelCheck:
        return check_model([film], [smooth * wrong[:, None, None]], [parted * chance[:, None]])

    never, always = t < 0, t >= 0
    found = judge(never, t > 50)
    assert within_noise(found) and found.excluded_s == (pytest.approx(t[-1] - 50, abs=1.5),)
    assert not within_noise(judge(always, t > 50)), "millimetres of chance hid what was left before"
    assert judge(t > 52, t > 50).unexplained < 0.05e-3, "what is left after they parted was counted"
    assert judge(never, never).excluded_s == (0.0,) and within_noise(judge(never, (t > 30) & (t < 32)))
    early = judge(never, t > 39)
    assert early.unexplained < early.limit < 0.15e-3 and not early.is_decidable and not within_noise(early)
    nothing = judge(never, always)
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


def test_a_robot_that_blows_up_is_worse_than_every_other(recording: Recording) -> None:
    """In the held-out cycle it fails the test, and the model that is merely wrong wins."""
    film = recording.tracked.positions
    blown = film.copy()
    blown[recording.tracked.times > recording.end - recording.period / 4] = np.nan
    wrong = film - 5e-3 * np.sin(recording.tracked.times)[:, None, None] * np.ones((5, 2))
    lost, off = (check_model([recording], [x]) for x in (blown, wrong))
    assert lost.rms > 10 * off.rms and lost.unexplained > 10 * off.unexplained > 10 * off.limit
    z, exact = np.zeros(1), check_model([recording], [film])
    fit = DynamicsFit(("hot_length",), z, np.eye(1), (1e-4, 1e-4), (1e-4, 1e-4), 1, z, exact)
    assert CandidateModel(SOFT, fit, lost).verdict is FitVerdict.WRONG
    assert all(np.isfinite(v) for both in lost.entries()["marks"].values() for v in both.values())


def test_a_marker_that_was_never_seen_is_no_perfect_one(recording: Recording) -> None:
    """Residuals of the markers that were seen are no smaller because others were covered."""
    t, rng = recording.tracked.times, np.random.default_rng(5)
    wave = 0.05e-3 * np.sqrt(2) * np.sin(t)[:, None] * np.array([-1, 1, -1, 1, 0])
    positions = np.stack([wave, wave], axis=-1) + 0.1e-3 * rng.standard_normal((len(t), 5, 2))
    positions[:, [0, 1, 4]] = np.nan
    once = positions.copy()
    once[7, 0] = 0.0
    still = [np.zeros_like(positions)]
    covered, glimpsed = (replace(recording.tracked, positions=x) for x in (positions, once))
    few, seldom = (check_model([replace(recording, tracked=x)], still) for x in (covered, glimpsed))
    assert few.unexplained == pytest.approx(0.05e-3, rel=0.05) and not within_noise(few)
    assert list(few.entries()["marks"]) == ["m3", "m4"] and np.isnan(few.correlated[:, 0]).all()
    assert list(seldom.entries()["marks"]) == ["m3", "m4"], "residuals of a single frame have no neighbours"


def test_a_model_that_does_not_fit_knows_nothing(recording: Recording, scene: PrintedScene) -> None:
    """However narrow the curvature: an interval reaches back to where the parameter was moved from."""
    left = 0.5e-3 * np.sin(recording.tracked.times)[:, None, None] * np.ones((5, 2))
    wrong = check_model([recording], [recording.tracked.positions - left])
    right = check_model([recording], [recording.tracked.positions - 1e-3 * left])
    z, narrow = np.array([2.0]), np.array([[1e-4]])
    for fits, unseen, known in ((wrong, right, False), (right, wrong, False), (right, right, True)):
        fit = DynamicsFit(("hot_length",), z, narrow, (1e-4, 1e-4), (1e-4, 1e-4), 1, z, fits)
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
        fit = DynamicsFit(names, z, 1e-4 * np.eye(2), (1e-4, 1e-4), (1e-4, 1e-4), 1, z, shown)
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
