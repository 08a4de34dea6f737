"""The report on a screen of 390 pixels: the camera's column, which is the result, is on the screen.

Skipped where Chromium is not installed.
"""

from pathlib import Path

import pytest

from eldir_calibration.report.controls import FilmedRun
from eldir_calibration.report.page import write_report
from tests.calibration.report.report_input import content
from tests.calibration.report.striding_walkers import walker
from tests.phone_screen import BROWSER, measured


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    far = walker(speed=-0.035, noise=1e-3)  # wide intervals, a sign before each number
    runs = tuple(FilmedRun(f"{name}.mcap", name, "", far, walker()) for name in ("intact", "without a motor"))
    folder = tmp_path_factory.mktemp("phone") / "report"
    write_report(content(tracked=far, before=walker(), runs=runs), folder)
    return folder / "index.html"


@pytest.mark.skipif(BROWSER is None, reason="Chromium is not installed")
@pytest.mark.parametrize("width", [390, 1400])
def test_the_filmed_column_is_seen(width: int, page: Path, tmp_path: Path) -> None:
    found = measured(page, width, tmp_path, "filmed")
    assert found["width"] == width
    assert len(found["heads"]) == 5, "displacement, runs, ranges twice, identification"
    assert max(found["heads"]) <= width and found["page"] <= width
    assert found["cut"] == [], "a table that is wider than the screen says so"
