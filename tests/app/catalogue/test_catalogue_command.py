"""`eldir runs` and its pages."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from eldir.trajectory import Trajectory
from eldir_app.application import application
from eldir_app.catalogue.comparison import ComparedRun, figures, write_comparison
from eldir_app.catalogue.facts import notes_file
from eldir_calibration.comparison.recorded_run import LoggedRun
from eldir_calibration.report.comparison import Motion
from eldir_hardware.log.reader import read_log
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule
from tests.app.catalogue.small_logs_and_reports import record, report
from tests.calibration.transfer.made_up_walks import tiny_design
from tests.paths import ROOT


@pytest.fixture(autouse=True)
def _own_index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def runs(*words: str | Path) -> Result:
    return CliRunner().invoke(application("runs"), ["runs", *map(str, words)])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "films"
    record(folder / "one.mcap")
    record(folder / "<i>two.mcap", "the board is silent", good=False, hours=1)
    (folder / "cut.mcap").write_bytes((folder / "one.mcap").read_bytes()[:-3000])
    report(folder / "one.mcap", folder / "report", 1.23)
    return folder


def test_the_table_tells_walk_end_and_damage(folder: Path) -> None:
    said = runs(folder)
    assert said.exit_code == 0
    lines = said.stdout.splitlines()
    assert [name in line for name, line in zip(("two", "one", "cut"), lines[1:4], strict=True)] == [True] * 3
    assert re.search(r"one\.mcap +2025-10-09 08:53 +\+1\.50 +\+1\.23 +agrees +to the end$", lines[2])
    assert lines[1].endswith("the board is silent") and "damaged: " in lines[3]
    assert lines[4] == "3 runs, 1 damaged"
    assert runs(folder, "--find", "silent").stdout.splitlines()[-1] == "1 run, 2 not chosen"
    first = json.loads(runs(folder, "--json", "--sort", "filmed").stdout)["runs"][0]
    assert first["reported"]["filmed"] == 1.23


def test_notes_and_tags_from_the_command(folder: Path) -> None:
    log = folder / "one.mcap"
    assert runs(log, "--note", "new strips", "--tag", "wood", "--tag", "good").exit_code == 0
    assert runs(log, "--untag", "wood").stdout.splitlines()[1].endswith("#good")
    assert [r["log"] for r in json.loads(runs(folder, "--find", "new strips", "--json").stdout)["runs"]] == [
        str(log)
    ]
    assert notes_file(log).exists()


def test_a_log_is_found_in_its_own_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    said = runs("one.mcap", "--note", "new strips", "--tag", "wood").stdout.splitlines()
    assert re.search(r"^one\.mcap .* agrees .* #wood$", said[1]) and said[2] == "1 run"
    for name in ("./one.mcap", "../films/one.mcap", folder / "one.mcap"):
        assert runs(name).stdout.splitlines()[-1] == "1 run"
    assert runs("one.mcap", "cut.mcap").stdout.splitlines()[-1] == "2 runs, 1 damaged"
    assert runs("one.mcap", folder, ".").stdout.splitlines()[-1] == "3 runs, 1 damaged"
    assert (
        "overlays 2 to 8 runs, these are 1"
        in runs("one.mcap", ".", "--compare", "a.html", "--find", "#wood").stderr
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "does not exist"),
        (["."], None),
        (["one.mcap", "--page", "page.txt"], "--page"),
        ([".", "--note", "x"], "for one log"),
        (["report/report.json", "--note", "x"], "for one log"),
        (["one.mcap", "--tag", "two words"], "tags"),
        ([".", "--sort", "colour"], "--sort"),
        ([".", "--since", "yesterday"], "--since"),
        ([".", "--compare", "both.html", "--find", "one.mcap"], "--compare"),
        (["report/report.json"], "neither a folder nor a log"),
    ],
)
def test_wrong_calls_change_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str | None
) -> None:
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    result = runs(*words)
    if said is None:
        assert result.exit_code == 0
    else:
        assert result.exit_code != 0 and said in f"{result.exception} {' '.join(result.output.split())}"
    assert sorted(folder.rglob("*")) == before


def test_the_page_stands_alone_and_links_to_what_is_there(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "pages" / "runs.html"
    assert runs(folder, "--page", page).exit_code == 0
    text = page.read_text()
    assert "<i>two" not in text and "&lt;i&gt;two.mcap" in text
    assert 'src="http' not in text and 'href="http' not in text
    links = re.findall(r'href="([^"]+)"', text)
    assert "../films/one.mcap" in links and "../films/%3Ci%3Etwo.mcap" in links
    assert runs(folder, "--page", page).exit_code != 0, "a page was overwritten"
    assert ">3 runs</span>" in text
    assert runs(folder / "one.mcap", "--page", tmp_path / "one.html").exit_code == 0
    assert ">1 run</span>" in (tmp_path / "one.html").read_text()


def test_a_report_without_its_page_is_not_linked(folder: Path, tmp_path: Path) -> None:
    runs(folder, "--page", tmp_path / "a.html")
    assert "index.html" not in (tmp_path / "a.html").read_text()
    (folder / "report" / "index.html").write_text("a page")
    runs(folder, "--page", tmp_path / "b.html")
    assert 'href="films/report/index.html">agrees' in (tmp_path / "b.html").read_text()


def compared(log: Path, name: str, speed: float, marks: int = 2, period: float = 2.0) -> ComparedRun:
    """A run that walks evenly with this speed [m/s], three cycles after one second."""
    times = np.arange(0.0, 1.0 + 3 * period + 0.05, 0.1)
    positions = np.zeros((len(times), marks, 2))
    positions[:, :, 0] = speed * times[:, None] + np.arange(marks)
    positions[:, :, 1] = 0.01 * np.sin(2 * np.pi * (times - 1.0) / period)[:, None]
    names = tuple(f"m{k + 1}" for k in range(marks))
    schedule = ActuationSchedule(period, events=(), cycles=3, conditioning_cycles=0, settle_s=1.0)
    rig = Rig.load(ROOT / "ros2_nodes" / "eldir_ros" / "config" / "rig.yaml")
    run = LoggedRun(tiny_design({}), schedule, rig, log=read_log(log))
    return ComparedRun(name, run, Motion(Trajectory(names, times, positions), 1.0, period, 3, 0.2))


def test_overlays_hold_what_was_filmed(folder: Path) -> None:
    log = folder / "one.mcap"
    both = [compared(log, "slow", 0.01), compared(log, "quick", 0.02, marks=3, period=3.0)]
    walk, by_cycle, heights = figures(both).values()  # these logs have no springs: nothing of temperatures
    slow, quick = walk.axes[0].get_lines()
    assert slow.get_ydata()[-1] == pytest.approx(1e3 * 0.01 * 6.0)
    assert quick.get_ydata()[-1] == pytest.approx(1e3 * 0.02 * 9.0)
    # Five cycles of 2 s at 0.01 m/s are 0.1 m, half a body length.
    per_cycle = [line.get_ydata() for line in by_cycle.axes[0].get_lines()]
    np.testing.assert_allclose(per_cycle, [[0.5] * 3, [1.5] * 3])
    assert [len(axes.get_lines()) for axes in heights.axes] == [2, 2, 1]
    assert max(heights.axes[0].get_lines()[0].get_ydata()) == pytest.approx(10.0, rel=0.05)


def test_a_comparison_tells_why_cycles_lack(folder: Path, tmp_path: Path) -> None:
    """A run that was paused, and one whose markers were hidden around the end of its first cycle."""
    whole = compared(folder / "one.mcap", "whole", 0.01)
    statuses = ((3.5, "player", "paused in cycle 2"), (9.0, "player", "played to the end"))
    log = replace(whole.run.log, statuses=statuses)
    paused = replace(whole, run=replace(whole.run, log=log), motion=replace(whole.motion, cycles=1))
    path = whole.motion.trajectory
    x = np.where(np.abs(path.times - 3.0)[:, None, None] < 0.5, np.nan, path.positions)
    hidden = replace(whole, motion=replace(whole.motion, trajectory=replace(path, positions=x)))
    write_comparison([whole, paused, hidden], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "<td>3</td>" in page and "<td>3; the walk is known in 1</td>" in page
    told = "1; paused at 3.5 s, later cycles do not count; last message of its player: played to the end"
    assert f"<td>{told}</td>" in page and page.count("<td>+0.50</td>") == 3


def test_logs_are_named_below_the_folder_that_they_share(folder: Path, tmp_path: Path) -> None:
    one, other = (
        compared(folder / "one.mcap", str(tmp_path / "films" / name), 0.01)
        for name in ("1/a.mcap", "2/a.mcap")
    )
    write_comparison([one, other], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert re.findall(r'<th scope="col">([^<]*)</th>', page) == ["1/a.mcap", "2/a.mcap"]
    write_comparison([one], tmp_path / "alone.html")
    assert '<th scope="col">a.mcap</th>' in (tmp_path / "alone.html").read_text()


def test_overlays_have_the_temperatures_of_the_last_cycle_or_say_that_there_are_none(
    folder: Path, tmp_path: Path
) -> None:
    cold = compared(folder / "one.mcap", "cold", 0.01)
    write_comparison([cold], tmp_path / "cold.html")
    assert "Not drawn: temperatures: no log has them." in (tmp_path / "cold.html").read_text()
    times = np.arange(0.0, 7.0)
    log = replace(
        cold.run.log, springs=("spring0_front",), temperature_times=times, temperatures=30.0 + times[:, None]
    )
    warm = replace(cold, run=replace(cold.run, log=log))
    *_, warmth = figures([warm, cold]).values()
    (line,) = warmth.axes[0].get_lines()  # three cycles of 2 s after one second
    np.testing.assert_allclose(line.get_xydata(), [[0, 35], [1, 36]])
    write_comparison([warm], tmp_path / "warm.html")
    assert "Not drawn" not in (tmp_path / "warm.html").read_text()
