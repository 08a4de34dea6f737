"""The report on a screen of 390 pixels: the camera's column, which is the result, is on the screen.

Skipped where Chromium is not installed.
"""

from pathlib import Path

import pytest

from eldir_calibration.report.page import write_report
from eldir_calibration.report.runs import FilmedRun
from tests.calibration.report.report_input import content
from tests.calibration.report.striding_walkers import walker
from tests.phone_screen import BROWSER, measured


@pytest.mark.skipif(BROWSER is None, reason="Chromium is not installed")
@pytest.mark.parametrize("width", [390, 1400])
def test_the_cameras_column_is_seen(width: int, tmp_path: Path) -> None:
    far = walker(speed=-0.035, noise=1e-3)  # wide intervals, a sign before each number
    runs = tuple(FilmedRun(f"{name}.mcap", name, "", far, walker()) for name in ("intact", "without a motor"))
    write_report(content(tracked=far, before=walker(), runs=runs), tmp_path / "report")
    found = measured(tmp_path / "report" / "index.html", width, tmp_path, "camera")
    assert found["width"] == width
    assert len(found["heads"]) == 5, "displacement, runs, ranges twice, identification"
    assert max(found["heads"]) <= width and found["page"] <= width
    assert found["cut"] == [], "a table that is wider than the screen says so"
