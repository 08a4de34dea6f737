"""Errors of a prediction cycle by cycle, against motions whose ranges and walks are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.scene import FittedErrors, PrintedScene
from eldir_calibration.dynamics._model_check import CycleMotions
from eldir_calibration.dynamics.recording import Recording
from eldir_calibration.dynamics.verdict import describe_predictions
from tests.calibration.dynamics.hidden_rigs import PERIOD, blank_film, walker
from tests.paths import DATA

RANGES = np.array([0.01, 0.02, 0.03, 0.02, 0.02])


def moving(blank: Recording, factor: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Marks that rise and fall once in each cycle by `RANGES` times the cycle's factor, and go forward by the
    cycle's step [m]."""
    t = np.maximum(blank.tracked.times - blank.start, 0.0)
    cycle = np.minimum((t / PERIOD).astype(int), blank.cycles - 1)
    heights = RANGES * (factor[cycle] * (0.5 - 0.5 * np.cos(2 * np.pi * t / PERIOD)))[:, None]
    forward = np.interp(t, PERIOD * np.arange(blank.cycles + 1), np.concatenate([[0.0], np.cumsum(step)]))
    return np.stack([np.broadcast_to(forward[:, None], heights.shape), heights], axis=2)


def filmed(blank: Recording, x: np.ndarray) -> Recording:
    return replace(blank, tracked=replace(blank.tracked, positions=x))


def test_errors_of_ranges_and_walks_cycle_by_cycle() -> None:
    blank = blank_film(walker(), 3)
    true = moving(blank, np.ones(3), np.array([0.01, 0.02, -0.01]))
    film = filmed(blank, true)
    found = CycleMotions.of(film, true)
    assert found.ranges == pytest.approx(np.tile(RANGES, (3, 1)), rel=1e-3)
    assert found.walks == pytest.approx([0.01, 0.02, -0.01], abs=1e-4)
    assert found.per_five_cycles(0.2) == pytest.approx([0.25, 0.5, -0.25], abs=3e-3)
    told = CycleMotions.of(film, moving(blank, np.array([1.0, 0.9, 1.2]), np.array([0.01, 0.02, 0.0])))
    assert found.range_errors(told) == pytest.approx([0.0, 0.1, 0.2], abs=2e-3)
    assert (told.walks - found.walks) == pytest.approx([0.0, 0.0, 0.01], abs=1e-4)


def test_only_what_the_camera_saw_counts_and_no_prediction_counts_as_wrong() -> None:
    blank = blank_film(walker(), 2)
    true = moving(blank, np.ones(2), np.array([0.01, 0.01]))
    wrong = true.copy()
    wrong[:, 2, 1] *= 3
    t = blank.tracked.times
    hidden = true.copy()
    hidden[t > blank.start + PERIOD, 2] = np.nan
    film = filmed(blank, hidden)
    seen = CycleMotions.of(film, hidden)
    first, second = seen.range_errors(CycleMotions.of(film, wrong))
    assert first == pytest.approx(2 * RANGES[2] / RANGES.sum(), rel=1e-2) and second == 0.0
    assert seen.walks == pytest.approx([0.01, 0.01], abs=1e-4), "a hidden mark counts as one that stays"
    lost = np.where((t > blank.start + PERIOD)[:, None, None], np.nan, true)
    assert seen.range_errors(CycleMotions.of(film, lost))[1] == pytest.approx(1.0)


def test_errors_in_fitted_cycles_make_predictions_doubtful() -> None:
    whole = PrintedScene.load(DATA / "built-scene-1.json").identification

    def said(ranges: float | None, walk: float | None, *, fits: bool = True) -> list[str]:
        model = replace(whole.model, predicts=fits)
        held_out = replace(whole.held_out_cycle, fitted_cycles=FittedErrors(ranges, walk))
        return describe_predictions(replace(whole, model=model, held_out_cycle=held_out))

    assert said(0.049, 0.099) == said(0.01, None, fits=False) == []
    (far,) = said(0.071, 0.099)
    assert "doubtful" in far and "ranges by up to 7.1%" in far and "walk" not in far
    (both,) = said(0.071, 0.16)
    assert "ranges by up to 7.1%" in both and "walk by up to 0.16 body lengths" in both
    assert said(0.071, 0.16, fits=False) == [both]
    (same,) = said(0.049, 0.099, fits=False)
    assert "predicted all the same" in same and "another gait may not be" in same


def test_noise_of_the_tracks_adds_nothing_to_filmed_ranges() -> None:
    blank = blank_film(walker(), 2)
    true = moving(blank, np.ones(2), np.array([0.01, 0.01]))
    true[:, 0, 1] = 0.0
    rng = np.random.default_rng(2)
    film = filmed(blank, true + 0.15e-3 * rng.standard_normal(true.shape))
    raw = CycleMotions.of(film, film.tracked.positions)
    assert raw.ranges[:, 0].min() > 0.6e-3, "a mark that rests seems to move by more than four deviations"
    exact, found = CycleMotions.of(film, true), raw.without_noise(film, true)
    assert np.abs(found.ranges - exact.ranges).max() < 0.25e-3
    assert (raw.ranges - exact.ranges).mean() > 0.3e-3
    assert abs((found.ranges - exact.ranges).mean()) < 0.06e-3
