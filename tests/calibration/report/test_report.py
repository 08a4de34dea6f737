"""The report as files: a page that stands alone, pictures, and numbers by a schema."""

import html
import json
import math
import re
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from matplotlib.image import imread

from eldir.errors import EldirError
from eldir_calibration.report.controls import INTACT, FilmedRun
from eldir_calibration.report.numbers import OutOfPlaneNumbers, ReportNumbers
from eldir_calibration.report.page import write_report
from eldir_calibration.report.verdict import RobotLoss, SampledMotions
from eldir_hardware.vision.tracking_quality import TrackingQuality
from tests.calibration.report.report_input import SCHEMA, content
from tests.calibration.report.striding_walkers import walker
from tests.paths import DATA
from tests.raised import raises


def test_page_pictures_and_numbers(plain_report: Path) -> None:
    page = (plain_report / "index.html").read_text()
    assert "A &lt;walker&gt;" in page and "The ground was wet." in page
    assert "http://" not in page.replace("http://www.w3.org", "") and "<script" not in page
    pictures = sorted(p.stem for p in plain_report.glob("*.png"))
    assert pictures == ["advance", "heating", "heights", "paths", "ranges"]
    for name in pictures:
        picture = imread(BytesIO((plain_report / f"{name}.png").read_bytes()))
        assert min(picture.shape[:2]) > 200 and picture.std() > 0.02, name
    values = json.loads((plain_report / "report.json").read_text())
    jsonschema.validate(values, SCHEMA)
    assert values["body_lengths_per_5_cycles"]["simulated"] == pytest.approx(0.5)
    assert values["masses"]["m2"]["vertical_range_m"]["predicted"] == pytest.approx(0.0132, rel=1e-3)
    assert values["masses"]["m2"]["vertical_range_body_lengths"]["predicted"] == pytest.approx(
        0.066, rel=1e-3
    )
    assert f"{values['body_lengths_per_5_cycles']['tracked']:+.2f}" in page


def test_the_same_report_has_the_same_bytes(tmp_path: Path, plain_report: Path) -> None:
    write_report(content(), tmp_path / "report")
    first, second = (
        {p.name: p.read_bytes() for p in f.iterdir()} for f in (plain_report, tmp_path / "report")
    )
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []


def test_a_prediction_before_and_after_identification(tmp_path: Path, plain_report: Path) -> None:
    """The same shape of motion, a tenth too high before."""
    told = content(
        before=walker(lift=0.0033), predicted=walker(lift=0.003), tracked=walker(lift=0.003, noise=1e-6)
    )
    write_report(told, tmp_path / "report")
    values = json.loads((tmp_path / "report" / "report.json").read_text())
    jsonschema.validate(values, SCHEMA)
    before, after = (values["identification"][when] for when in ("before", "after"))
    assert before["vertical_range_error"] == pytest.approx(0.1, abs=2e-3)
    assert after["vertical_range_error"] < 2e-3 and after["height_error_m"] < 1e-5
    assert after["vertical_range_m"]["m2"] == values["masses"]["m2"]["vertical_range_m"]["predicted"]
    page = (tmp_path / "report" / "index.html").read_text()
    assert "before and after identification" in page and "identified parameters" in page
    assert "identification" not in (plain_report / "report.json").read_text()


def test_what_was_not_seen_is_null_and_said(tmp_path: Path) -> None:
    tracked = walker(noise=1e-5)
    x = tracked.trajectory.positions.copy()
    x[:, 0] = math.nan
    blind = type(tracked)(
        type(tracked.trajectory)(("m1", "m2"), tracked.trajectory.times, x),
        tracked.start, tracked.period, tracked.cycles, tracked.body_length,
    )  # fmt: skip
    write_report(content(tracked=blind), tmp_path / "report")
    values = json.loads((tmp_path / "report" / "report.json").read_text())
    jsonschema.validate(values, SCHEMA)
    assert values["masses"]["m1"]["vertical_range_m"]["tracked"] is None
    assert ">unknown<" in (tmp_path / "report" / "index.html").read_text()
    assert any("m1" in w and "0%" in w for w in values["warnings"])


def test_nothing_is_overwritten_and_nothing_half_written(tmp_path: Path) -> None:
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "mine.txt").write_text("mine")
    with raises(EldirError, "file.exists"):
        write_report(content(), tmp_path / "report")
    assert [p.name for p in (tmp_path / "report").iterdir()] == ["mine.txt"]
    with pytest.raises(ValueError):
        write_report(content(provenance={"log": object()}), tmp_path / "other")
    assert [p.name for p in tmp_path.iterdir()] == ["report"]


def test_the_page_opens_with_the_finding_and_the_film(tmp_path: Path) -> None:
    samples = SampledMotions(
        np.array([0.4, 0.45, 0.5, 0.55, 0.6]), np.full((5, 2), 0.012), np.full((5, 2), 0.01)
    )
    departure = OutOfPlaneNumbers((0, 8, 19), (5, 8, 11), (-0.04, -0.03, -0.02), 0.07, True, 61.5, True)
    path = walker().trajectory
    quality = TrackingQuality.of(path, np.ones((len(path.times), 2)))
    told = content(samples=samples, film=b"a film", quality=quality, departure=departure)
    lost = FilmedRun(
        "log.mcap", INTACT, "", told.tracked, told.predicted, loss=RobotLoss(61.5, "fell sideways")
    )
    told = replace(told, runs=(lost,))
    write_report(told, tmp_path / "report")
    page = (tmp_path / "report" / "index.html").read_text()
    assert (tmp_path / "report" / "film.webm").read_bytes() == b"a film"
    verdict = json.loads((tmp_path / "report" / "report.json").read_text())["verdict"]
    walk = verdict["body_lengths_per_5_cycles"]
    assert "turned about the vertical by at most\n19 degrees at the end, leaned by at most 11" in page
    assert "wrong by 0.07 body lengths" in page and "as they do here" in page
    assert f'<section class="headline {walk["agreement"]}"' in page
    head = page[page.index("<section") : page.index("</section>")]
    low, high = walk["predicted_interval"]
    for shown in (walk["predicted"], low, high, walk["tracked"]):
        assert f"{shown:+.2f}" in head
    sentence = head[head.index("sentence") + 10 :].split("</p>")[0]
    assert html.unescape(sentence) in verdict["text"]
    assert sentence.strip("\n >").endswith(
        "But the robot fell over sideways at 61.5 s; only cycles that ended before count."
    )
    assert page.index("data:video/webm") < page.index("<table")
    for name in re.findall(r'href="#([^"]+)"', page):
        assert f'id="{name}"' in page
    for picture in re.findall(r"<(?:img|video|svg)[^>]{0,600}", page):
        (told,) = re.findall(r'(?:alt|aria-label)="([^"]*)"', picture)
        assert len(told) > 40, picture
    assert "prefers-color-scheme: dark" in page and "@media print" in page


def test_a_report_of_version_0_1_0_is_read_and_written_as_it_is(tmp_path: Path) -> None:
    report = ReportNumbers.load(DATA / "old" / "report.json")
    assert report.verdict.body_lengths_per_5_cycles.agreement == "disagrees"
    assert math.isnan(report.tracking.size_change[1]) and report.runs[1].robot == "without a motor"
    report.save(tmp_path / "report.json")
    assert (tmp_path / "report.json").read_bytes() == (DATA / "old" / "report.json").read_bytes()
