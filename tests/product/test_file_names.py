"""Names of files that are not UTF-8 or no files at all, and streams that are closed, from the command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from eldir.errors import InputError
from eldir.evolution import tables
from eldir_hardware.images.video import write_webm
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from tests.app.catalogue.small_logs_and_reports import record
from tests.forked_programs import Forked
from tests.raised import raises

ODD = os.fsdecode(b"dir\xe4")


STRICT = {"PYTHONIOENCODING": "utf-8:strict"}
"""Standard output takes nothing but UTF-8, as in most places."""


def eldir(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "eldir", *map(str, arguments)]
    pipe, folder = subprocess.PIPE, None if cwd is None else str(cwd)
    with Forked(words, stdout=pipe, stderr=pipe, env=os.environ | STRICT, cwd=folder) as program:
        said = program.communicate(120)
        return subprocess.CompletedProcess(words, program.returncode, *said)


def started(*arguments: object, shell: str) -> subprocess.CompletedProcess[str]:
    """As `eldir`, by a line of a shell, which may close streams."""
    return subprocess.run(
        ["sh", "-c", shell, "sh", sys.executable, "-m", "eldir", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env=os.environ | STRICT,
    )


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    """A folder whose name is not UTF-8."""
    (tmp_path / ODD).mkdir()
    return tmp_path / ODD


def test_runs_are_listed_and_kept(odd: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(odd.parent / "cache"))
    record(odd / "one.mcap")
    record(odd.parent / "two.mcap", hours=1)
    for _ in range(2):  # the second time from the index
        found = json.loads(eldir("runs", odd.parent, "--json").stdout)["runs"]
        assert [run["log"] for run in found] == [str(odd.parent / "two.mcap"), str(odd / "one.mcap")]
    noted = eldir("runs", odd / "one.mcap", "--note", os.fsdecode(b"\xe4"), "--page", odd / "runs.html")
    assert noted.returncode == 0 and "dir\\udce4/one.mcap" in noted.stdout
    assert (odd / "one.mcap.notes.json").exists() and "dir\\udce4" in (odd / "runs.html").read_text()


def test_a_run_is_evolved_told_and_analysed(odd: Path) -> None:
    run = odd / "run"
    small = ("--lattice", "3x5", "--population", 2, "--generations", 0, "--iterations", 1)
    made = eldir("evolve", *small, "--out", run)
    assert made.returncode == 0, made.stderr
    assert "dir\\udce4/run: finished" in eldir("status", run).stdout
    assert eldir("analyse", run, "--out", odd / "figures").stdout.endswith("figures/index.html\n")


def test_columns_of_a_table_are_read(odd: Path) -> None:
    (odd / "a.parquet").write_bytes(tables.to_bytes({"a": [1, 2], "b": [3, 4]}, "x"))
    assert tables.read(odd / "a.parquet", ["b"]).to_pydict() == {"b": [3, 4]}
    with raises(InputError, "file.missing"):
        tables.read(odd / "none.parquet", ["b"])


def test_a_video_is_written(odd: Path) -> None:
    write_webm(odd / f"{ODD}.webm", np.zeros((3, 64, 64, 3), np.uint8), 25)
    (odd.parent / "copy.webm").write_bytes((odd / f"{ODD}.webm").read_bytes())
    assert cv2.VideoCapture(str(odd.parent / "copy.webm")).read()[0]


def test_a_rig_file_does_not_name_such_a_design(odd: Path) -> None:
    refused = eldir("rig", "new", "--design", f"{ODD}.json", "--out", odd / "rig.yaml")
    assert refused.returncode == 1 and not (odd / "rig.yaml").exists()
    assert "expected a name in UTF-8" in refused.stderr and refused.stderr.count("\n") == 1


@pytest.mark.parametrize("name", ["my: robot #1.json", "1.5", "robot ä.json", "a \"b\" 'c'.json", "a\nb"])
def test_a_rig_file_names_any_other_design(name: str, tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(virtual_rig(design=name))
    assert Rig.load(tmp_path / "rig.yaml").virtual.design == name


def test_a_design_is_named_from_where_the_person_stands(tmp_path: Path) -> None:
    """And from the rig file's folder in the rig file, so that both can be moved together."""
    for folder in ("robots", "rigs"):
        (tmp_path / folder).mkdir()
    (tmp_path / "robots" / "one.json").touch()
    words = ["rig", "new", "--design", "robots/one.json", "--out", "rigs/rig.yaml"]
    done = eldir(*words, cwd=tmp_path)
    assert done.returncode == 0 and "does not exist" not in done.stdout, done.stderr
    assert Rig.load(tmp_path / "rigs" / "rig.yaml").virtual.design == "../robots/one.json"


@pytest.mark.parametrize("name", [".", "", ".."])
def test_what_is_no_file_is_not_shown(name: str) -> None:
    refused = eldir("show", name)
    assert refused.returncode == 1
    assert refused.stderr.startswith("eldir: ") and refused.stderr.count("\n") == 1


def test_closed_streams_cost_only_what_they_would_have_taken(tmp_path: Path) -> None:
    """A file that got the descriptor of a closed stream would have the stream's lines in it."""
    whole = virtual_rig(physics="mujoco")
    for number, closed in enumerate((">&-", "2>&-", "<&-", "<&- >&- 2>&-")):
        out = tmp_path / f"{number}.yaml"
        made = started("rig", "new", "--out", out, shell=f'exec "$@" {closed}')
        assert (made.returncode, made.stderr) == (0, ""), closed
        assert (made.stdout == "") == (" >&-" in f" {closed}")
        assert out.read_text() == whole
    refused = started("show", tmp_path / "none.json", shell='exec "$@" 2>&-')
    assert (refused.returncode, refused.stdout) == (1, "")
