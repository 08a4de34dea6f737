"""The report on a screen of 390 pixels: the camera's column, which is the result, is on the screen.

Skipped where Chromium is not installed.
"""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from calibration.report.page import write_report
from calibration.report.runs import FilmedRun
from tests.calibration.reports import content
from tests.calibration.walkers import walker

BROWSER = next((found for name in ("chromium", "google-chrome") if (found := shutil.which(name))), None)
QUIET = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
# A window is 500 pixels wide at least, a frame in it is not.
FRAME = """<!DOCTYPE html><title></title>
<iframe style="width: {width}px; height: 1400px; border: 0" srcdoc="{page}" onload="
  const inner = this.contentDocument;
  const heads = [...inner.querySelectorAll('th')].filter(cell => cell.textContent.includes('camera'));
  document.title = JSON.stringify({{
    width: this.contentWindow.innerWidth,
    page: inner.documentElement.scrollWidth,
    camera: heads.map(cell => cell.getBoundingClientRect().right),
  }});
"></iframe>"""


def measured(page: Path, width: int, folder: Path) -> dict:
    """Width of the screen and of the page, and the right edge of every head "camera" [px]."""
    frame = folder / "frame.html"
    frame.write_text(FRAME.format(width=width, page=html.escape(page.read_text())))
    own = f"--user-data-dir={folder / 'browser'}"
    call = [BROWSER, *QUIET, "--window-size=1600,1500", own, "--dump-dom", frame.as_uri()]
    text = subprocess.run(call, capture_output=True, text=True, check=True, timeout=120).stdout
    return json.loads(html.unescape(re.search("<title>(.*)</title>", text)[1]))


@pytest.mark.skipif(BROWSER is None, reason="Chromium is not installed")
@pytest.mark.parametrize("width", [390, 1400])
def test_the_cameras_column_is_seen(width: int, tmp_path: Path) -> None:
    far = walker(speed=-0.035, noise=1e-3)  # wide intervals, a sign before each number
    runs = tuple(FilmedRun(f"{name}.mcap", name, "", far, walker()) for name in ("intact", "without a motor"))
    write_report(content(tracked=far, before=walker(), runs=runs), tmp_path / "report")
    found = measured(tmp_path / "report" / "index.html", width, tmp_path)
    assert found["width"] == width
    assert len(found["camera"]) == 5, "displacement, runs, ranges twice, identification"
    assert max(found["camera"]) <= width and found["page"] <= width
