"""The page "I have a relay board and a camera", played to its last command without hardware."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from eldir_app.catalogue.facts import read_facts
from tests.app.watch.bench import watching
from tests.app.watch.browser import browser
from tests.paths import ROOT

pytestmark = [pytest.mark.stress, pytest.mark.timeout(1800)]
PAGE = ROOT / "docs" / "how-to" / "board-and-camera.md"


def commands(text: str) -> list[list[str]]:
    """Its commands, for a virtual rig: other words in step 1, and without the steps 2 and 3."""
    sections = re.split(r"^## (?=\d)", text, flags=re.MULTILINE)[1:]
    played = [part for part in sections if part[0] not in "23"]
    lines = [line.strip() for part in played for line in re.findall(r"^    eldir .*", part, re.MULTILINE)]
    return [re.sub(r"--board lcus --port \S+", "--board virtual", line).split() for line in lines]


def play(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-m", *words], cwd=folder, capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, (words, done.stdout, done.stderr)
    return done


def test_the_page_of_board_and_camera_is_played_on_a_virtual_rig(tmp_path: Path) -> None:
    design = ROOT / "ros2_nodes" / "eldir_ros" / "config" / "design.json"
    (tmp_path / "design.json").write_bytes(design.read_bytes())
    played = commands(PAGE.read_text())
    assert [words[1] for words in played] == ["rig", "gait", "rig", "rig", "track", "report"]
    for words in played:
        if words[1:3] != ["rig", "drive"] or "--dry-run" in words:
            play(words, tmp_path)
            continue
        with watching("--rig", tmp_path / "rig.yaml") as (address, _), browser() as page:
            page.open(address)
            page.wait("document.getElementById('mode').innerText.startsWith('No schedule')")
            play(words, tmp_path)
            page.wait("document.getElementById('mode').innerText == 'Ended: log.mcap'")
            page.wait("document.getElementById('events').innerText.includes('played to the end')")
    facts = {name: read_facts(tmp_path / name) for name in ("rehearsal.mcap", "log.mcap")}
    assert [f.rehearsal for f in facts.values()] == [True, False]
    assert {f.ended for f in facts.values()} == {"played to the end"}
    assert (tmp_path / "report" / "index.html").exists() and (tmp_path / "tracks.png").exists()
