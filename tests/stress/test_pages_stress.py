"""Pages whose commands anyone can type without hardware, played in an empty folder, as written and in order.

Only what takes hours as written is made smaller: another population, fewer runs.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.paths import ROOT

pytestmark = [pytest.mark.stress, pytest.mark.timeout(3600)]
DEMO_DESIGN = ROOT / "ros2_nodes" / "eldir_ros" / "config" / "design.json"


class Page(NamedTuple):
    """What is played of a page."""

    name: str
    smaller: dict[str, str]
    """Options that are added to commands that begin so."""
    begin: str = ""
    """Heading from which it is played."""
    needs: tuple[str, ...] = ()
    """Files that the reader has already: a design."""
    makes: tuple[str, ...] = ()
    """Some of what is there at the end."""


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
        needs=("design.json",),
        makes=("scene.json", "second.mcap"),
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
    words = shlex.split(line)
    for begin, options in page.smaller.items():
        if line.startswith(begin):
            words += options.split()
    if words[0] == "eldir":
        words[:1] = [sys.executable, "-m", "eldir"]
    elif words[0] == "python":
        words[0] = sys.executable
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=3000, check=False)
    assert done.returncode == 0, (line, done.stdout, done.stderr)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_is_played(page: Page, tmp_path: Path) -> None:
    text = (ROOT / "docs" / page.name).read_text()
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    for name in page.needs:
        shutil.copy(DEMO_DESIGN, tmp_path / name)
    played = parts(text[text.index(page.begin) :])
    assert len(played) > 3
    for kind, content in played:
        if kind == "run":
            play(content, page, tmp_path)
        elif content.startswith("format: "):
            (tmp_path / "printer.yaml").write_text(content)
        else:  # lines that the reader adds to the rig file's last section
            (tmp_path / "rig.yaml").write_text(merged((tmp_path / "rig.yaml").read_text(), content))
    for name in page.makes:
        assert (tmp_path / name).exists(), name


def merged(rig: str, section: str) -> str:
    """A rig file with the lines of a section that it lacks."""
    known = {line.strip().partition(":")[0] for line in rig.splitlines()}
    new = [line for line in section.splitlines() if line.strip().partition(":")[0] not in known]
    assert new, "the page adds nothing"
    return rig.rstrip("\n") + "\n" + "\n".join(new) + "\n"
