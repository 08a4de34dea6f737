"""The report's main finding: prediction against film, within the uncertain robot's interval."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from eldir_calibration.report.page import write_report
from eldir_calibration.report.verdict import (
    RobotLoss,
    SampledMotions,
    evaluate_prediction,
    horizontal_swings,
    prediction_interval,
)
from tests.calibration.report.report_input import SCHEMA, content
from tests.calibration.report.striding_walkers import LENGTH, walker

SPEEDS = (0.006, 0.008, 0.010, 0.012, 0.014)
"""Of samples [m a cycle]: 0.15 to 0.35 body lengths per five cycles."""


def sampled(*, lifts=(0.0028, 0.0029, 0.0030, 0.0031, 0.0032), fell: int = 0) -> SampledMotions:
    motions = [walker(speed=v, lift=lift) for v, lift in zip(SPEEDS, lifts, strict=True)]
    return SampledMotions.of([*motions, *[None] * fell], 2)


def test_the_interval_is_students():
    found = prediction_interval(np.array([1.0, 2.0, 3.0, 4.0, 5.0, -np.inf]))
    reach = 2.776445 * np.sqrt(2.5) * np.sqrt(1.2)  # t of four degrees of freedom at 0.975, from a table
    assert (found.mean, found.low, found.high) == pytest.approx((3.0, 3.0 - reach, 3.0 + reach), abs=1e-5)
    assert np.isnan(prediction_interval(np.array([1.0, -np.inf])).low)
    assert np.isnan(prediction_interval(np.zeros(0)).mean)


def test_it_contains_one_more_robot_as_often_as_it_says():
    rng = np.random.default_rng(0)
    walks = rng.normal(0.4, 0.2, (4000, 9))
    inside = 0
    for row in walks:
        found = prediction_interval(row[:8])
        inside += found.low <= row[8] <= found.high
    assert 0.94 < inside / 4000 < 0.96


def test_what_samples_do_is_measured_as_on_film():
    found = sampled(fell=2)
    assert found.walks[:5] == pytest.approx(np.array(SPEEDS) / LENGTH * 5, rel=1e-6)
    assert found.fell == 2 and np.isneginf(found.walks[5:]).all() and np.isnan(found.ranges[5:]).all()
    # Marker one swings by 4 mm either way, two samples a cycle are at most 2 % from the turning points.
    assert found.swings[0] == pytest.approx([0.008, 0.008], rel=0.02)
    assert found.ranges[0] == pytest.approx([0.0056, 0.0112], rel=0.02)
    assert horizontal_swings(walker(swing=0.006)) == pytest.approx([0.012, 0.012], rel=0.02)


@pytest.mark.parametrize(
    ("speed", "noise", "agreement", "words"),
    [
        (0.0112, 1e-5, "agrees", "They agree: the film lies within the prediction's interval."),
        (0.0300, 1e-5, "disagrees", "They disagree: the film lies outside the prediction's interval."),
    ],
)
def test_whether_film_and_prediction_agree(speed, noise, agreement, words):
    v = evaluate_prediction(walker(speed=0.0105), walker(speed=speed, noise=noise), sampled(fell=3))
    assert v.walk.agreement == agreement and words in v.text
    assert f"Filmed: {speed / LENGTH * 5:+.2f} (" in v.text
    assert "Predicted: +0.25 body lengths per five cycles, +0.01 to +0.49 for 95 % of robots" in v.text
    assert "(+0.26 for the most probable parameters; 3 of 8 samples fall)" in v.text


def test_a_scattered_film_decides_nothing():
    """Its mean lies outside; over its cycles it reaches inside."""
    v = evaluate_prediction(walker(), walker(speed=0.022), sampled())
    film = replace(v.walk.tracked, low=0.3, high=0.8)
    assert replace(v.walk, tracked=film).agreement == "undecided"
    assert replace(v.walk, tracked=replace(film, low=0.53)).agreement == "disagrees"


def test_scatter_over_cycles_is_not_the_interval():
    """A perfectly regular prediction once had an interval of a thousandth beside a film that differs."""
    v = evaluate_prediction(walker(speed=0.0105), walker(speed=0.0115), sampled())
    assert v.walk.predicted.high - v.walk.predicted.low > 0.4
    assert v.walk.agreement == "agrees"


def test_a_walk_out_of_the_plane_is_less_certain():
    """What the film alone would refute is not decided where the robot may have turned as far."""
    predicted, film = walker(speed=0.0105), walker(speed=0.0300, noise=1e-5)
    flat, left = (evaluate_prediction(predicted, film, sampled(), error) for error in (0.0, 0.3))
    assert (flat.walk.agreement, left.walk.agreement) == ("disagrees", "undecided")
    assert left.walk.tracked.low == pytest.approx(flat.walk.tracked.low - 0.3)
    assert "over cycles and out of the plane)" in left.text and "out of the plane" not in flat.text


@pytest.mark.parametrize("speed, level", [(0.0112, "undecided"), (0.0300, "disagrees")])
def test_a_film_that_was_fitted_does_not_agree(speed, level):
    """Within the interval it would agree; outside, the model does not even describe its own film."""
    reason = "this film was used for the identification, so this is no test"
    predicted, film = walker(speed=0.0105), walker(speed=speed, noise=1e-5)
    v = evaluate_prediction(predicted, film, sampled(), no_test=reason)
    assert v.walk.agreement == level and v.sentence.endswith(f"But {reason}.")
    within = "Not decided: the film lies within the prediction's interval."
    assert v.sentence.startswith(within if level == "undecided" else "They disagree: ")
    assert v.sentence in v.text and "They agree" not in v.text
    assert all(m.agreement != "agrees" for m in v.motions)


@pytest.mark.parametrize(
    ("speed", "agreement", "words"),
    [
        (
            0.0112,
            "undecided",
            "Not decided: the film lies within the prediction's interval. But the robot fell ",
        ),
        (0.0300, "disagrees", "outside the prediction's interval. But the robot fell "),
    ],
)
def test_a_robot_that_fell_never_agrees(speed, agreement, words):
    """Of a walk that ended in a fall the cycles before say nothing good, and a wrong one stays wrong."""
    loss = RobotLoss(71.75, "fell")
    v = evaluate_prediction(walker(), walker(speed=speed, noise=1e-5), sampled(), loss=loss)
    assert v.walk.agreement == agreement and "They agree" not in v.text
    assert all(m.agreement != "agrees" for m in v.motions)
    assert f"{words}over at 71.8 s; only cycles that ended before count." in v.text
    unknown = evaluate_prediction(walker(), walker(), None, loss=loss)
    assert unknown.walk.agreement is None and unknown.sentence.endswith(
        "no samples. But the robot fell over at 71.8 s; only cycles that ended before count."
    )


def test_the_motion_that_disagrees_most_is_named():
    """Marker two lifts twice as far as marker one; only its lift is wrong on film."""
    film = walker()
    film.trajectory.positions.setflags(write=True)
    film.trajectory.positions[:, 1, 1] = 0.06 + 1.5 * (film.trajectory.positions[:, 1, 1] - 0.06)
    v = evaluate_prediction(walker(), film, sampled())
    worst = v.worst
    assert (worst.marker, worst.quantity, worst.agreement) == ("m2", "vertical range", "disagrees")
    assert "The vertical range of m2 disagrees most: predicted 12.0 mm" in v.text
    assert "filmed 18.0 mm, outside the interval; 1 of 4 ranges and swings lie outside" in v.text


def test_without_samples_nothing_is_decided():
    v = evaluate_prediction(walker(), walker(noise=1e-5), None)
    assert v.walk.agreement is None and v.worst is None
    assert "It is unknown whether they agree: no samples." in v.text
    fallen = evaluate_prediction(walker(), walker(), SampledMotions.of([None] * 4, 2))
    assert "only 0 of 4 samples stay upright" in fallen.text


def test_a_film_without_markers_is_the_reason_why_nothing_is_known():
    """The samples are all there: the verdict and its text must not blame them."""
    film = walker(noise=1e-5)
    film.trajectory.positions.setflags(write=True)
    film.trajectory.positions[:] = np.nan
    v = evaluate_prediction(walker(), film, sampled())
    assert v.walk.agreement is None and "does not show how far" in v.sentence
    assert v.text.endswith(f"The film does not show the walk. {v.sentence}")
    assert "samples stay upright" not in v.text


def test_the_page_opens_with_it(tmp_path: Path):
    made = content(samples=sampled(fell=1), tracked=walker(speed=0.03, noise=1e-5))
    report = write_report(made, tmp_path / "report")
    page = (tmp_path / "report" / "index.html").read_text()
    values = json.loads((tmp_path / "report" / "report.json").read_text())
    jsonschema.validate(values, SCHEMA)
    said = values["verdict"]["text"]
    assert said == made.verdict.text and "They disagree" in said
    shown = page.replace("&#39;", "'")
    assert 0 < shown.index(said) < shown.index("The ground was wet.") < shown.index("<table")
    low, high = values["verdict"]["body_lengths_per_5_cycles"]["predicted_interval"]
    assert values["body_lengths_per_5_cycles_interval"]["predicted"] == [low, high]
    assert report.displacement_intervals["predicted"].low == pytest.approx(low, abs=1e-8)
    one = values["masses"]["m2"]["vertical_range_interval_m"]
    (m2_range,) = [
        m for m in values["verdict"]["motions_m"] if (m["mark"], m["motion"]) == ("m2", "vertical range")
    ]
    assert one["predicted"] == m2_range["predicted_interval"] != one["tracked"]


def test_the_table_says_whose_prediction_it_shows(tmp_path: Path, plain_report: Path):
    """That of the most probable robot; the card shows the mean of the samples, which differs."""
    made = content(predicted=walker(speed=0.0105), samples=sampled())
    write_report(made, tmp_path / "report")
    page = (tmp_path / "report" / "index.html").read_text()
    assert f"<dt>predicted</dt><dd>{made.verdict.walk.predicted.mean:+.2f}</dd>" in page
    table = page[page.index('<h2 id="displacement">') : page.index('<h2 id="ranges-table">')]
    assert "<th>predicted (this schedule), most probable robot</th>" in table and "<td>+0.26<br>" in table
    words = " ".join(table.split())
    assert (
        "that of the most probable robot, with the nominal parameters; the mean of the samples is +0.25."
        in words
    )
    assert "the mean of the samples" not in (plain_report / "index.html").read_text()


def test_a_report_without_samples_says_so(plain_report: Path):
    values = json.loads((plain_report / "report.json").read_text())
    jsonschema.validate(values, SCHEMA)
    assert values["verdict"]["samples"] == 0 and values["verdict"]["largest_disagreement"] is None
