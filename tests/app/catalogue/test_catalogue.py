"""The catalogue: logs, reports and notes are the truth, the index is never more than what was read."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import get_args

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

from eldir.errors import InputError
from eldir_app.catalogue import Column
from eldir_app.catalogue.facts import Notes, notes_file, read_notes, write_notes
from eldir_app.catalogue.listing import COLUMNS, ordered, selected
from eldir_app.catalogue.runs import CataloguedRun, Index
from tests.app.catalogue.small_logs_and_reports import found, later, record, report
from tests.paths import SCHEMAS
from tests.raised import raises


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two good logs, one that ended with a fault, three that no reader takes, and what is not to be found."""
    folder = tmp_path / "films"
    record(folder / "a" / "one.mcap")
    record(folder / "two.mcap", hours=1)
    record(folder / "b" / "stopped.mcap", "the board is silent", good=False, hours=2)
    (folder / "empty.mcap").touch()
    (folder / "cut.mcap").write_bytes((folder / "two.mcap").read_bytes()[:-3000])
    with (folder / "foreign.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    record(folder / ".draft" / "hidden.mcap")
    (folder / "link").symlink_to(folder, target_is_directory=True)
    return folder


def test_every_log_is_there_once_and_damaged_ones_say_why(folder: Path, tmp_path: Path) -> None:
    catalogue, read = found(folder, tmp_path / "index")
    runs = {str(run.log.relative_to(folder)): run for run in catalogue.runs}
    assert set(runs) == {
        "a/one.mcap", "two.mcap", "b/stopped.mcap", "empty.mcap", "cut.mcap", "foreign.mcap",
    }  # fmt: skip
    assert read == 6 and catalogue.problems == ()
    one, stopped = runs["a/one.mcap"], runs["b/stopped.mcap"]
    assert (one.recorded, one.frames, one.seconds) == ("2025-10-09T08:53:20Z", 4, 1.0)
    assert (one.ended, one.faults, one.damage) == ("played to the end", (), "")
    assert stopped.faults == ("player: the board is silent",)
    assert "is empty" in runs["empty.mcap"].damage
    assert "not a complete MCAP log" in runs["cut.mcap"].damage
    assert "not the log of a run" in runs["foreign.mcap"].damage
    values = {"format": "eldir-runs/1", "runs": [asdict(run) for run in catalogue.runs]}
    values = json.loads(json.dumps(values, default=str))
    jsonschema.validate(values, json.loads((SCHEMAS / "runs.schema.json").read_text()))


def test_a_file_is_read_again_only_after_it_changed(folder: Path, tmp_path: Path) -> None:
    index = tmp_path / "index"
    first, _ = found(folder, index)
    again, read = found(folder, index)
    assert read == 0 and again == first
    (folder / "two.mcap").unlink()
    record(folder / "two.mcap", "stopped by Ctrl-C")
    (folder / "empty.mcap").unlink()
    changed, read = found(folder, index)
    assert read == 1
    assert {r.log.name: r.ended for r in changed.runs}["two.mcap"] == "stopped by Ctrl-C"
    with Index(index) as kept:
        assert str(folder / "empty.mcap") not in kept.read(str(folder))
    afresh, _ = found(folder, tmp_path / "another")
    assert afresh == changed, "the index said something that the files do not say"


def test_one_log_does_not_make_the_index_forget_the_others(folder: Path, tmp_path: Path) -> None:
    found(folder, tmp_path / "index")
    (run,) = found(folder / "two.mcap", tmp_path / "index")[0].runs
    assert run.log == folder / "two.mcap"
    assert found(folder, tmp_path / "index")[1] == 0


@pytest.mark.parametrize("harm", ["noise", "cut", "another table", "another version", "a folder"])
def test_a_harmed_index_costs_only_time(folder: Path, tmp_path: Path, harm: str) -> None:
    index = tmp_path / "index"
    first, _ = found(folder, index)
    if harm == "noise":
        index.write_bytes(bytes(range(256)) * 40)
    elif harm == "cut":
        index.write_bytes(index.read_bytes()[:5000])
    elif harm == "a folder":
        index.unlink()
        index.mkdir()
    else:
        with sqlite3.connect(index) as store:
            store.execute("PRAGMA user_version = 77" if harm == "another version" else "DROP TABLE files")
        store.close()
    again, read = found(folder, index)
    assert again == first and read == 6
    if harm != "a folder":
        assert found(folder, index)[1] == 0, "the index was not made again"


def test_a_report_finds_its_log_wherever_it_lies(folder: Path, tmp_path: Path) -> None:
    one = folder / "a" / "one.mcap"
    old = report(one, folder / "reports" / "old", 0.2, "disagrees")
    new = report(one, folder / "reports" / "new", 1.2)
    later(new, 5.0)
    (folder / "reports" / "foreign").mkdir()
    (folder / "reports" / "foreign" / "report.json").write_text('{"format": "else"}')
    one.rename(folder / "renamed.mcap")
    runs = {run.log.name: run for run in found(folder, tmp_path / "index")[0].runs}
    run = runs["renamed.mcap"]
    assert (run.expected, run.filmed, run.verdict, run.report) == (1.5, 1.2, "agrees", new)
    assert runs["two.mcap"].report is None and runs["two.mcap"].filmed is None
    later(old, 9.0)
    assert found(folder, tmp_path / "index")[0].runs != ()
    runs = {run.log.name: run for run in found(folder, tmp_path / "index")[0].runs}
    assert runs["renamed.mcap"].verdict == "disagrees", "the newest report counts"


def test_notes_stand_beside_the_log_and_move_with_it(folder: Path, tmp_path: Path) -> None:
    log = folder / "two.mcap"
    written = write_notes(log, Notes().changed("slipped in cycle 3", ["wood", "good"], []))
    jsonschema.validate(
        json.loads(written.read_text()), json.loads((SCHEMAS / "notes.schema.json").read_text())
    )
    write_notes(log, read_notes(log).changed(None, ["blue"], ["wood"]))
    assert read_notes(log).tags == ("blue", "good")
    moved = folder / "b" / "moved.mcap"
    notes_file(log).rename(notes_file(log.rename(moved)))
    runs = {run.log.name: run for run in found(folder, tmp_path / "index")[0].runs}
    assert runs["moved.mcap"].tags == ("blue", "good")
    assert [n.text for n in runs["moved.mcap"].notes] == ["slipped in cycle 3"]
    notes_file(moved).write_text('{"format": "eldir-notes/1", "tags": ["a b"], "notes": []}')
    catalogue, _ = found(folder, tmp_path / "index")
    assert len(catalogue.runs) == 6 and "tags.0" in catalogue.problems[0]


@pytest.mark.parametrize("tag", ["", "two words", "#a", "x" * 41, "a/b", "a\n"])
def test_a_tag_that_a_word_cannot_find_is_refused(tag: str) -> None:
    with pytest.raises(InputError, match="tags"):
        Notes().changed(None, [tag], [])


@pytest.mark.parametrize("text", ["", "  ", "x" * 2001])
def test_a_note_without_words_or_of_a_whole_book_is_refused(text: str) -> None:
    with raises(InputError, "input.wrong-value", "note"):
        Notes().changed(text, [], [])


def _run(name: str, **facts: object) -> CataloguedRun:
    return CataloguedRun(Path(name), 1, **facts, tags=("good",))  # type: ignore[arg-type]


walks = st.none() | st.floats(-3, 3)


@given(st.lists(walks, max_size=8), st.booleans())
def test_runs_without_a_value_come_last_in_both_directions(values: list[float | None], turned: bool) -> None:
    runs = [_run(str(k), predicted=v) for k, v in enumerate(values)]
    given_ = [r.expected for r in ordered(runs, "predicted", turned)]
    known = [v for v in given_ if v is not None]
    assert known == sorted((v for v in values if v is not None), reverse=not turned)
    assert given_[len(known) :] == [None] * (len(values) - len(known))


def test_every_name_of_a_column_is_one() -> None:
    assert tuple(COLUMNS) == get_args(Column)


@pytest.mark.parametrize("column", COLUMNS)
def test_every_column_sorts_runs_that_know_nothing(column: Column) -> None:
    assert len(ordered([_run("a"), _run("b", damage="is empty")], column)) == 2


def test_words_choose_runs_by_everything_that_is_shown() -> None:
    runs = [
        _run("x/wood.mcap", rig="Bench 2", recorded="2026-11-20T10:00:00Z"),
        _run("x/cloth.mcap", rig="bench 1", recorded="2026-11-22T10:00:00Z", ended="the board is silent"),
        _run("x/gone.mcap", damage="x/gone.mcap is empty"),
    ]

    def names(*words: str, since: date | None = None) -> list[str]:
        return [run.log.stem for run in selected(runs, words, since)]

    assert names("BENCH") == ["wood", "cloth"] and names("bench", "silent") == ["cloth"]
    assert names("#good", "damaged") == ["gone"] and names("#goo") == ["wood", "cloth", "gone"]
    assert names(since=date(2026, 11, 21)) == ["cloth"] and names("nowhere") == []
