"""Runs that survive: killed, stopped, out of room, damaged; and how they stand meanwhile."""

import errno
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from eldir.errors import EldirError, InputError
from eldir.evolution.loop import run_generations
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.status import read_status
from tests.eldir.evolution.counting_evaluation import Counting
from tests.eldir.evolution.killed_run import CONFIG, Pretence
from tests.eldir.evolution.pretended_searches import fitness
from tests.eldir.evolution.run_folders import contents
from tests.forked_programs import Forked
from tests.paths import ROOT
from tests.raised import raises

SCHEMA = json.loads((ROOT / "docs" / "schemas" / "status.schema.json").read_text())


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, bytes]:
    """What an uninterrupted run leaves."""
    run = RunFolder.create(tmp_path_factory.mktemp("whole") / "run", CONFIG)
    with run.locked():
        run_generations(run, run.restore(), Pretence())
    return contents(run.path)


def test_killed_at_random_instants_a_run_ends_with_the_same_bytes(tmp_path, whole):
    folder, rng, kills = tmp_path / "run", np.random.default_rng(8), 0
    while True:
        command = [sys.executable, "-m", "tests.eldir.evolution.killed_run", str(folder)]
        with Forked(command, stdout=subprocess.PIPE) as process:
            process.stdout.readline()  # it has begun
            try:
                # Longer and longer, so that a busy machine comes to the end as well.
                assert process.wait(timeout=rng.uniform(0.02, 0.15) + 0.1 * kills) == 0
                break
            except subprocess.TimeoutExpired:
                process.kill()
                kills += 1
        assert kills < 100
    assert kills >= 2
    assert contents(folder) == whole


def test_killed_between_the_last_survivors_and_tidying_up_nothing_outdated_stays(tmp_path, whole):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    run_generations(run, run.restore(), Pretence())
    for outdated in ("survivors-0010.parquet", "part-0012-000000.parquet", ".part-0012-000005.parquet.x1"):
        (run.path / outdated).write_bytes(b"outdated")
    with run.locked():
        assert contents(run.path) == whole


def test_a_generation_is_saved_while_the_next_one_learns(tmp_path, whole, monkeypatch):
    """Its files are written only after the next generation has begun to learn."""
    learns, fsync, generations, late = threading.Event(), os.fsync, 0, 0

    def after_the_next_has_begun(handle: int) -> None:
        nonlocal late
        if threading.current_thread() is not threading.main_thread():
            late += learns.wait(20)
        fsync(handle)

    class Learning(Pretence):
        def __call__(self, shards):
            nonlocal generations
            generations += 1
            if generations > 1:
                learns.set()
            yield from super().__call__(shards)

    run = RunFolder.create(tmp_path / "run", CONFIG)
    monkeypatch.setattr(os, "fsync", after_the_next_has_begun)
    with run.locked():
        run_generations(run, run.restore(), Learning())
        assert late == 2 * (CONFIG.generations + 1) and contents(run.path) == whole


def test_killed_while_a_generation_is_saved_its_robots_learn_again_and_the_next_ones_do_not(tmp_path, whole):
    run, trainer = RunFolder.create(tmp_path / "run", CONFIG), Counting(4)
    run_generations(run, run.restore(), trainer, trainer.stopped)
    assert len(run.parts(1)) == 1
    for unwritten in (run.path / "survivors-0000.parquet", run.generation_file(0)):
        unwritten.unlink()
    again = Counting()
    with run.locked():
        run_generations(run, run.restore(), again)
        assert contents(run.path) == whole
    assert set(trainer.seeds[:12]) < set(again.seeds) and not set(trainer.seeds[12:]) & set(again.seeds)


@pytest.mark.parametrize("shards", [1, 2, 3, 17])
def test_stopped_at_any_shard_no_robot_learns_twice(tmp_path, whole, shards):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    trained: list[int] = []
    while True:
        search, trainer = run.restore(), Counting(shards)
        run_generations(run, search, trainer, trainer.stopped)
        trained += trainer.seeds
        if search.finished:
            break
    assert len(trained) == len(set(trained)) == CONFIG.population * (CONFIG.generations + 1)
    with run.locked():
        assert contents(run.path) == whole


def test_progress_counts_robots(tmp_path):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    seen: list[float] = []
    trainer = Counting(4)
    run_generations(run, run.restore(), trainer, trainer.stopped, seen.append)
    assert np.round(12 * np.array(seen), 9).tolist() == [0, 5, 10, 12, 0, 0, 5]


def test_status_while_it_runs_when_stopped_and_at_the_end(tmp_path):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    empty = read_status(run)
    assert (empty.state, empty.whole, empty.best_m, empty.seconds_left) == ("stopped", 0, None, None)
    trainer, search = Counting(10), run.restore()
    with run.locked():
        run_generations(run, search, trainer, trainer.stopped)
        for g in range(3):
            os.utime(run.generation_file(g), (70.0 * g, 70.0 * g))
        status = read_status(run)
        with raises(EldirError, "run.locked"), RunFolder.open(run.path).locked():
            pass
    assert (status.state, status.whole, status.learned) == ("evolving", 3, 5)
    assert status.best_m == fitness(search)[0]
    assert status.mean_m == pytest.approx(fitness(search).mean())
    assert (status.evaluated, status.discarded) == (36, 0)
    assert status.seconds_a_generation == 70 and status.seconds_left == pytest.approx(70 * (10 - 5 / 12))
    assert "3 of 13 generations and 5 of 12 robots" in status.summary()
    assert status.summary().endswith("; 1:10 min a generation, 11:11 min left")
    assert read_status(run).state == "stopped"
    run_generations(run, search, Pretence())
    assert read_status(run).state == "finished"
    for found in (empty, status, read_status(run)):
        jsonschema.validate(json.loads(json.dumps(found.to_json())), SCHEMA)


def test_the_time_left_is_told_from_the_last_five_generations(tmp_path):
    """Three of them took 100 s; older ones, which were quicker, do not count, and neither does one alone."""
    run = RunFolder.create(tmp_path / "run", CONFIG)
    trainer = Counting(3 * 9)  # nine generations of three shards
    run_generations(run, run.restore(), trainer, trainer.stopped)
    ends = 1e9 + np.cumsum([0.0, 1, 1, 1, 100, 100, 100, 1, 1])
    for g, end in enumerate(ends):
        os.utime(run.generation_file(g), (end, end))
    status = read_status(run)
    assert (status.whole, status.learned) == (9, 0)
    assert status.seconds_a_generation == 100.0
    assert status.seconds_left == 100.0 * (CONFIG.generations + 1 - 9)


def test_a_copied_run_does_not_tell_how_long_a_generation_takes(tmp_path):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    trainer = Counting(10)
    run_generations(run, run.restore(), trainer, trainer.stopped)
    for g in range(3):  # as after `cp -r`
        os.utime(run.generation_file(g), (1e9 + 1e-4 * g, 1e9 + 1e-4 * g))
    status = read_status(run)
    assert (status.whole, status.seconds_a_generation, status.seconds_left) == (3, None, None)
    assert " a generation" not in status.summary() and " left" not in status.summary()


def test_the_discarded_are_counted(tmp_path):
    class Unstable(Pretence):
        def __call__(self, shards):
            for shard, outcome in super().__call__(shards):
                outcome[0].losses[1] = np.nan
                yield shard, outcome

    run = RunFolder.create(tmp_path / "run", CONFIG)
    trainer = Counting(3)
    trainer.__class__ = type("Both", (Counting, Unstable), {})
    run_generations(run, run.restore(), trainer, trainer.stopped)
    assert (read_status(run).evaluated, read_status(run).discarded) == (12, 3)


def test_a_full_disk_is_named_and_nothing_is_lost(tmp_path, whole, monkeypatch):
    run, calls, fsync = RunFolder.create(tmp_path / "run", CONFIG), 0, os.fsync

    def full(handle: int) -> None:
        nonlocal calls
        calls += 1
        if calls % 9 == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", full)
    search, failures = run.restore(), 0
    while not search.finished:
        try:
            run_generations(run, search, Pretence())
        except EldirError as error:
            assert "No space left" in str(error)
            failures += 1
            search = run.restore()
    assert failures >= 3
    monkeypatch.undo()
    with run.locked():
        assert contents(run.path) == whole


def test_a_limit_of_the_system_is_named(tmp_path):
    """A real refusal to write: no file may grow beyond 100 bytes."""
    run = RunFolder.create(tmp_path / "run", CONFIG)
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "from tests.eldir.evolution import killed_run; from pathlib import Path\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)); killed_run.run(Path(sys.argv[1]))"
    )
    command = [sys.executable, "-c", code, str(run.path)]
    done = subprocess.run(command, check=False, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert "cannot write" in done.stderr
    assert "File too large" in done.stderr
    assert sorted(contents(run.path)) == ["lock", "run.json"]


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    run = RunFolder.create(tmp_path / "run", CONFIG)

    def refuse(self: Path, mode: str = "r") -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "open", refuse)
    with raises(EldirError, "file.not-written", match="Read-only file system"), run.locked():
        pass


def test_a_damaged_part_is_named_and_its_robots_learn_again(tmp_path, whole):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    trainer = Counting(2)
    run_generations(run, run.restore(), trainer, trainer.stopped)
    part = run.parts(0)[0]
    part.write_bytes(part.read_bytes()[:-20])
    with raises(InputError, "file.damaged", match=rf"{part.name}.*remove it"):
        run_generations(run, run.restore(), Pretence())
    part.unlink()
    with run.locked():
        run_generations(run, run.restore(), Pretence())
    assert contents(run.path) == whole
