"""What an identified robot says: which parameter explains which motion, what to film next, the pictures."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread

from eldir.built.gait import Gait
from eldir.built.scene import PrintedScene
from eldir.core.pictures import png
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.uncertain import is_unobservable
from eldir_calibration.dynamics.figures import (
    draw_attribution,
    draw_experiments,
    draw_held_out,
    draw_intervals,
)
from eldir_calibration.dynamics.identifiability import (
    Experiment,
    RangeAttribution,
    attribute_ranges,
    rank_experiments,
)
from eldir_calibration.dynamics.recording import Recording, predict_markers
from tests.calibration.dynamics.hidden_rigs import SOFT, walker
from tests.eldir.built.filmed_walker import OFF


@pytest.fixture(scope="module")
def found(recording: Recording, scene: PrintedScene) -> RangeAttribution:
    return attribute_ranges(walker(), recording, SOFT, scene)


def test_shares_add_up_to_what_changed(
    recording: Recording, scene: PrintedScene, found: RangeAttribution
) -> None:
    """Against the vertical ranges of both robots, driven on their own."""
    nominal, identified = predict_markers(walker(), [recording], [SOFT, scene.robot])[0]
    last = recording.tracked.times >= recording.end - recording.period
    change = np.ptp(identified[last, :, 1], axis=0) - np.ptp(nominal[last, :, 1], axis=0)
    assert np.abs(found.change - change).max() < 1e-4
    assert found.parameters == tuple(OFF) and np.abs(found.shares[-2:]).max() < 1e-15, (
        "unobservable parameters"
    )
    biggest = np.abs(found.shares).sum(axis=1).argsort()[-3:]
    assert "buckling" not in {found.parameters[i] for i in biggest}
    assert set(found.numbers.vertical_range_m_from_nominal) == {*OFF, "all"}


def test_what_to_film_next(scene: PrintedScene) -> None:
    """A robot that is not heated tells less than one that walks; no film tells the weight."""
    walking = Gait(20.0, np.array([0.0, 0.875]), np.full(2, 0.3))
    idle = Gait(20.0, np.array([0.0, 0.875]), np.full(2, 0.01))
    first, second = rank_experiments(walker(), scene, [idle, walking])
    assert first.gait is walking and first.information > 2 * second.information > 0
    assert first.remaining_spread["weight"] == pytest.approx(1, abs=1e-6)
    assert first.remaining_spread["friction"] < np.sqrt(scene.covariance[4, 4])


def test_hubs_are_ranked_as_pins_without_repetitions(
    scene: PrintedScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The films to come took longer to rank than the robot to identify."""
    seen = []

    def counted(body, recordings, robots, *, coarse):
        seen.extend(robots)
        return predict_markers(body, recordings, robots, coarse=coarse)

    monkeypatch.setattr("eldir_calibration.dynamics._problem.predict_markers", counted)
    walking = Gait(20.0, np.array([0.0, 0.875]), np.full(2, 0.3))
    rank_experiments(walker(), replace(scene, built=scene.built.with_hubs()), [walking])
    assert {r.printed.joints for r in seen} == {"pins"}
    assert len(seen) == 1 + 2 * sum(not is_unobservable(name) for name in scene.parameters)


def test_hubs_become_the_pins_that_they_were_made_from() -> None:
    pins = BuiltParameters(tension=15e3)
    assert pins.with_hubs().with_pins() == pins
    assert BuiltParameters.clamped().with_pins() == BuiltParameters.clamped()


def test_pictures_show_what_was_found(scene: PrintedScene, found: RangeAttribution) -> None:
    film = Experiment(Gait(20.0, np.array([0.0, 0.5]), np.full(2, 0.3)), 3.0, {})
    drawn = [
        draw_intervals(scene),
        draw_attribution(found),
        draw_held_out(scene, found.markers),
        draw_experiments([film]),
    ]
    for picture in (imread(BytesIO(png(figure))) for figure in drawn):
        assert min(picture.shape[:2]) > 90 and picture.std() > 0.02
