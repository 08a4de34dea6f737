"""Pages whose commands anyone can type without hardware, played in an empty folder, as written and in order.

Only what takes hours as written is made smaller: another population, fewer runs. Commands that need hardware,
or act on more than the folder, are named and skipped. Other pages are played elsewhere: board and camera in
test_how_to_stress.py, a board of one's own in tests/hardware/relay, Python in tests/product/test_docs.py.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.paths import ROOT

pytestmark = [pytest.mark.stress, pytest.mark.timeout(7200)]
LARGE_DESIGN = ROOT / "ros2_nodes" / "eldir_ros" / "config" / "design.json"
SMALL_DESIGN = ROOT / "tests" / "data" / "demo-design.json"
"""The robot of `make demo`; identifying a large one takes hours."""


class Page(NamedTuple):
    """What is played of a page."""

    name: str
    smaller: dict[str, str]
    """Options that are added to commands that begin so."""
    begin: str = ""
    """Heading from which it is played."""
    then: tuple[str, ...] = ()
    """Beginnings of commands above that heading, which are played at the end."""
    before: tuple[str, ...] = ()
    """What the reader of the page has done already."""
    skipped: tuple[str, ...] = ()
    """Beginnings of commands that are not played."""
    design: Path | None = None
    """The design that the reader has already."""
    makes: tuple[str, ...] = ()
    """Some of what is there at the end."""


WALK = (
    "eldir rig new --board virtual --out rig.yaml --design design.json",
    "eldir gait design.json --rig rig.yaml --out schedule.json",
    "eldir rig drive schedule.json --rig rig.yaml --log log.mcap",
)
PAGES = [
    Page(
        "tutorial.md", {}, makes=("demo/report-after/index.html", "picture.png", "walk.webm", "tracks.json")
    ),
    Page(
        "how-to/simulate.md",
        {"eldir evolve": "--population 16 --generations 2"},
        makes=("figures/index.html", "run/run.json"),
    ),
    Page(
        "how-to/printer.md",
        {"eldir evolve": "--population 16 --generations 3"},
        makes=("packet/kit.pdf", "packet-control/manifest.json", "coupon/coupon.csv"),
    ),
    Page(
        "how-to/identify.md",
        {},
        begin="## Try it on a virtual robot",
        then=("eldir gait", "eldir report"),
        design=SMALL_DESIGN,
        makes=("scene.json", "second.mcap", "next.json", "report/index.html"),
    ),
    Page(
        "installation.md",
        {},
        skipped=("eldir demo", "eldir --install-completion", "eldir --show-completion"),  # the person's shell
    ),
    Page(
        "benchmarks.md",
        {"eldir benchmark": "--quick"},
        skipped=("python -m benchmarks",),  # in a checkout, with other programs
        makes=("speed/speed.json", "skips/skips.png"),
    ),
    Page(
        "reference/rig.md",
        {},
        design=LARGE_DESIGN,
        # messages to people; boards of this computer; a recording
        skipped=("notify:", "eldir rig off", "eldir calibrate springs"),
        makes=("log.mcap", "hold.mcap"),
    ),
    Page(
        "reference/runs.md",
        {},
        design=LARGE_DESIGN,
        before=(*WALK, "mkdir films", *(f"cp log.mcap films/{name}.mcap" for name in ("walk", "a", "b"))),
        makes=("runs.html", "both.html"),
    ),
    Page(
        "reference/report.md",
        {},
        design=LARGE_DESIGN,
        before=WALK,
        skipped=("eldir report log.mcap without.mcap",),  # three robots
        makes=("report/index.html",),
    ),
]


def parts(text: str) -> list[tuple[str, str]]:
    """Commands, and files that the reader writes, in order: ("run", line) or ("yaml", text)."""
    found = []
    for block in re.finditer(r"^```yaml\n(.*?)^```$|^    ((?:eldir|cp|python) [^\n]*)$", text, re.M | re.S):
        found.append(("yaml", block[1]) if block[1] else ("run", block[2]))
    return found


def play(line: str, page: Page, folder: Path) -> None:
    """Run a line as a shell would, with `eldir` and `python` of this environment."""
    words = shlex.split(line, comments=True)
    for begin, options in page.smaller.items():
        if line.startswith(begin):
            words += options.split()
    if words[0] == "eldir":
        words[:1] = [sys.executable, "-m", "eldir"]
    elif words[0] == "python":
        words[0] = sys.executable
    environment = os.environ | {"XDG_STATE_HOME": str(folder / "state")}
    done = subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, timeout=7200, check=False
    )
    assert done.returncode == 0, (line, done.stdout, done.stderr)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_is_played(page: Page, tmp_path: Path) -> None:
    text = (ROOT / "docs" / page.name).read_text()
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    if page.design is not None:
        shutil.copy(page.design, tmp_path / "design.json")
    begin = text.index(page.begin)
    above = [(kind, line) for kind, line in parts(text[:begin]) if kind == "run"]
    played = [part for part in parts(text[begin:]) if not part[1].startswith(page.skipped)]
    played += [part for part in above if part[1].startswith(page.then)]
    known = [content for _, content in parts(text)]
    for name in (*page.skipped, *page.then):
        assert any(content.startswith(name) for content in known), f"{name}: no longer on the page"
    assert played
    for line in page.before:
        play(line, page, tmp_path)
    for kind, content in played:
        if kind == "run":
            play(content, page, tmp_path)
        elif content.startswith("format: "):
            (tmp_path / "printer.yaml").write_text(content)
        elif content.startswith(("cutoff: ", "limits: ")):  # lines that replace those of the rig file
            (tmp_path / "rig.yaml").write_text(replaced((tmp_path / "rig.yaml").read_text(), content))
        else:  # lines that the reader adds to the rig file's last section
            (tmp_path / "rig.yaml").write_text(merged((tmp_path / "rig.yaml").read_text(), content))
    for name in page.makes:
        assert (tmp_path / name).exists(), name


def replaced(rig: str, lines: str) -> str:
    """A rig file with other lines for its sections of these names."""
    for line in lines.splitlines():
        name = line.partition(":")[0]
        rig, count = re.subn(rf"^{name}: .*$", line, rig, flags=re.M)
        assert count == 1, f"the rig file has no line {name}"
    return rig


def merged(rig: str, section: str) -> str:
    """A rig file with the lines of a section that it lacks."""
    known = {line.strip().partition(":")[0] for line in rig.splitlines()}
    new = [line for line in section.splitlines() if line.strip().partition(":")[0] not in known]
    assert new, "the page adds nothing"
    return rig.rstrip("\n") + "\n" + "\n".join(new) + "\n"
