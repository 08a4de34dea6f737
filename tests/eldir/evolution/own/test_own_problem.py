"""A problem of another package: found by its entry point, searched, interrupted, refused in one line."""

from __future__ import annotations

import json
import re
import runpy
import signal
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from eldir.errors import EldirError, InputError
from eldir.evolution import evolve, load_run, resume
from eldir.evolution.loop import run_generations
from eldir.evolution.own.registration import GROUP, load_problem
from eldir.evolution.own.run_folder import ProblemRun
from eldir.evolution.own.vectors import OwnProblem, ProblemConfig
from eldir.evolution.problem import Batch, Part, evaluate_here
from eldir.evolution.search import Search
from eldir.evolution.status import read_status
from eldir.evolution.workers import LocalWorkers
from eldir_app.application import application
from tests.eldir.evolution.own.noisy_hill import CONFIG, NoisyHill
from tests.eldir.evolution.run_folders import contents
from tests.paths import ROOT, SCHEMAS
from tests.raised import raises

TALL = ROOT / "examples" / "own_problem.py"


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a package as `pip install` leaves it."""
    folder = tmp_path / "site"
    (folder / "hills-1.0.dist-info").mkdir(parents=True)
    (folder / "raising_problem.py").write_text("1 / 0\n")
    info = folder / "hills-1.0.dist-info"
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: hills\nVersion: 1.0\n")
    hill = "tests.eldir.evolution.own.noisy_hill"
    (info / "entry_points.txt").write_text(
        f"[{GROUP}]\nhill = {hill}:NoisyHill\nraises = raising_problem:P\nabsent = no_such_module:P\n"
        f"wrong = {hill}:CONFIG\n"
    )
    monkeypatch.syspath_prepend(folder)
    return folder


def command(*words: object) -> Any:
    return CliRunner().invoke(application(str(words[0])), [str(word) for word in words])


class Backwards(LocalWorkers):
    """One task a part, the last one first, as on a cluster whose workers differ."""

    def part_size(self, batch: Batch, tasks: int) -> int:
        return 1

    def __call__(self, parts: Iterable[Part]) -> Iterator[tuple[Part, Any]]:
        for part in reversed(list(parts)):
            yield part, part.run()


def test_neither_interruptions_nor_workers_change_a_byte(tmp_path: Path, installed: Path) -> None:
    whole = evolve(CONFIG, tmp_path / "whole")
    parts = ProblemRun.create(tmp_path / "parts", CONFIG)
    stops = 0
    while not (search := parts.restore(NoisyHill())).finished:
        run_generations(parts, search, Backwards(), iter([False, True]).__next__)
        stops += 1
    assert stops == CONFIG.generations + 1
    parts.path.joinpath(f"archive-{CONFIG.generations:04d}.parquet").unlink()
    resume(parts.path)
    assert contents(parts.path) | {"lock": b""} == contents(whole.path) | {"lock": b""}
    other = evolve(replace(CONFIG, seed=8), tmp_path / "other")
    assert other.read_last_elites() != whole.read_last_elites()


def test_fewer_reach_each_trial_and_the_archive_holds_the_best_of_each_niche(tmp_path: Path) -> None:
    """The hill is known, so the search's estimates are compared with it."""
    run, tasks = ProblemRun.create(tmp_path / "run", CONFIG), []
    search = run.restore(NoisyHill())
    while not search.finished:
        generation = None
        while generation is None:
            batch = search.ask()
            tasks.append((search.generation, batch.arguments[1], len(batch)))
            generation = search.tell(batch, evaluate_here(batch))
        run.save(generation)
        assert [s.trials for s in generation.tried].count(3) == len(generation.evaluated) == 3
    for number in range(CONFIG.generations + 1):
        counts = [(trial, n) for g, trial, n in tasks if g == number]
        assert counts[:3] == [(0, 12), (1, 6), (2, 3)]
    elites = run.read_last_elites()
    assert elites == search.archive.ranked() and len({s.niche for s in elites}) == len(elites) > 1
    for s in elites:
        assert s.niche == (int(np.floor(2 * s.vector[1])),)
        assert s.fitness == pytest.approx(s.objective.mean())
        assert s.error == pytest.approx(s.objective.std(ddof=1) / np.sqrt(len(s.objective)))
        assert abs(s.fitness - NoisyHill.height(s.vector[None])[0]) < 5 * s.error
    assert elites[0].samples == NoisyHill.max_samples, "the best one is evaluated again and again"
    assert elites[0].fitness > 0.9
    first = pq.read_table(run.generation_file(0))
    assert first["parent"].to_pylist() == [-1] * 12 and min(first["trials"].to_pylist()) == 1


def test_trials_leave_the_better_half(tmp_path: Path) -> None:
    search = Search(OwnProblem(NoisyHill(), CONFIG))
    batch = search.ask()
    rows = np.arange(12.0)[:, None]
    vectors = [vector for vector, _ in batch.tasks]
    search.tell(batch, rows)
    going_on = [vector.tolist() for vector, _ in search.ask().tasks]
    assert going_on == [vectors[i].tolist() for i in range(11, 5, -1)]


def test_what_is_not_finite_does_not_enter_the_archive() -> None:
    search = Search(OwnProblem(NoisyHill(), CONFIG))
    rows = np.full((12, 1), np.nan)
    rows[4] = 0.5
    search.tell(search.ask(), rows)
    search.tell(search.ask(), np.array([[np.nan, 1.0], [0.3, 0.3], *[[0.1, 0.1]] * 4]))
    generation = search.tell(search.ask(), np.array([[0.1, 0.2], [9.0, np.nan], [9.0, np.inf]]))
    assert generation is None, "the elite is evaluated again"
    generation = search.tell(search.ask(), np.array([[0.3, 0.2]]))
    assert generation is not None and [s.objective.tolist() for s in generation.elites] == [
        [0.1, 0.2, 0.3, 0.2]
    ]


@pytest.mark.parametrize(
    ("method", "returned"),
    [
        ("random", np.zeros((3, 2))),
        ("random", np.full((12, 2), np.nan)),
        ("evaluate", np.zeros(12)),
        ("evaluate", [["a"]] * 12),
        ("measures", np.zeros((4, 1))),
    ],
)
def test_wrong_arrays_are_named(method: str, returned: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(NoisyHill, method, lambda self, *_: returned)
    search = Search(OwnProblem(NoisyHill(), CONFIG))
    with raises(InputError, "problem.wrong-array", method):
        for _ in range(3):
            batch = search.ask()
            search.tell(batch, batch.trial(batch.tasks, *batch.arguments))


def test_only_the_batch_that_was_asked_for_can_be_told() -> None:
    search, other = (Search(OwnProblem(NoisyHill(), CONFIG)) for _ in range(2))
    batch = search.ask()
    assert search.ask() is batch
    with raises(EldirError, "evolution.other-batch"):
        search.tell(other.ask(), np.zeros((12, 1)))
    search.tell(batch, np.zeros((12, 1)))
    with raises(EldirError, "evolution.other-batch"):
        search.tell(batch, np.zeros((12, 1)))


def test_the_command_stops_at_ctrl_c_and_goes_on(
    installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The signal comes in the second generation, which is completed."""
    words = ["--population", "12", "--generations", "3", "--seed", "7"]
    run, whole = tmp_path / "run", tmp_path / "whole"
    assert command("evolve", "--problem", "hill", "--out", whole, *words).exit_code == 0
    evaluate, calls = NoisyHill.evaluate, 0

    def interrupted(self: NoisyHill, *arguments: Any) -> np.ndarray:
        nonlocal calls
        calls += 1
        if (run / "archive-0000.parquet").exists() and calls < 10**6:
            calls = 10**6
            signal.raise_signal(signal.SIGINT)
        return evaluate(self, *arguments)

    monkeypatch.setattr(NoisyHill, "evaluate", interrupted)
    stopped = command("evolve", "--problem", "hill", "--out", run, *words)
    assert stopped.exit_code == 130 and f"--resume {run}" in " ".join(stopped.output.split())
    assert "stopped, 2 of 4 generations" in command("status", run).output.replace("\n", " ")
    again = command("evolve", "--resume", run, "--json")
    told = json.loads(again.stdout)
    assert again.exit_code == 0 and told["state"] == "finished"
    jsonschema.validate(told, json.loads((SCHEMAS / "problem-status.schema.json").read_text()))
    values = json.loads((run / "run.json").read_text())
    jsonschema.validate(values, json.loads((SCHEMAS / "problem-run.schema.json").read_text()))
    assert contents(run) == contents(whole)


def test_a_run_can_be_read_but_not_continued_without_its_problem(tmp_path: Path) -> None:
    run = ProblemRun.create(tmp_path / "run", replace(CONFIG, generations=1))
    run_generations(run, run.restore(NoisyHill()), LocalWorkers(), iter([False, True]).__next__)
    assert "stopped, 1 of 2 generations, 12 solutions tried" in read_status(run).summary()
    with raises(InputError, "input.unknown-name", "problem", match="'hill'.*install the package"):
        resume(run.path)
    with raises(InputError, "run.no-robots", match="solutions of the problem hill"):
        load_run(run.path)
    assert "has no robots" in str(command("analyse", run.path, "--out", tmp_path / "out").exception)
    archive = run.path / "archive-0000.parquet"
    archive.write_bytes(run.generation_file(0).read_bytes()[:-9])
    with raises(InputError, "file.damaged", match=r"archive-0000"):
        read_status(run)


@pytest.mark.parametrize(
    ("name", "code", "found"),
    [
        ("hil", "input.unknown-name", "hill"),
        ("os:getcwd", "input.unknown-name", "hill"),
        ("raises", "package.broken", "ZeroDivisionError"),
        ("absent", "package.broken", "ModuleNotFoundError"),
        ("wrong", "package.broken", "not callable"),
    ],
)
def test_what_cannot_be_loaded_is_named(
    name: str, code: str, found: str, installed: Path, tmp_path: Path
) -> None:
    assert isinstance(load_problem("hill"), NoisyHill)
    with raises(InputError, code, "problem" if "unknown" in code else None, match=found):
        load_problem(name)
    refused = command("evolve", "--problem", name, "--out", tmp_path / "run")
    assert found in str(refused.exception) and not (tmp_path / "run").exists()


@pytest.mark.parametrize("surplus", ["--objective printed", "--lattice 4x6", "--explain"])
def test_options_of_robots_are_refused(surplus: str, installed: Path, tmp_path: Path) -> None:
    refused = command("evolve", "--problem", "hill", "--out", tmp_path / "run", *surplus.split())
    assert refused.exit_code == 2 and surplus.split(maxsplit=1)[0] in refused.output
    assert not (tmp_path / "run").exists()


def test_rows_of_the_example_do_not_depend_on_each_other() -> None:
    """As the interface asks; and its class has at most 60 lines."""
    namespace = runpy.run_path(str(TALL))
    problem, rng = namespace["TallRobots"](), np.random.default_rng(0)
    solutions = np.concatenate([problem.random(4, rng), np.zeros((1, problem.random(1, rng).shape[1]))])
    seeds = [3, 1, 4, 1, 5]
    together = problem.evaluate(solutions, 0, seeds)
    alone = [problem.evaluate(solutions[i : i + 1], 0, seeds[i : i + 1])[0] for i in range(5)]
    assert np.array_equal(together, alone) and np.isfinite(together).all()
    assert problem.measures(solutions).tolist() == [problem.measures(s[None])[0].tolist() for s in solutions]
    lines = TALL.read_text().split("class TallRobots")[1].split("if __name__")[0].rstrip().splitlines()
    assert len(lines) <= 60


def test_the_page_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All Python of it, block after block; then its class by the run folder."""
    page = (ROOT / "docs" / "how-to" / "own-problem.md").read_text()
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", page, re.S):
        exec(compile(block, "own-problem.md", "exec"), names)
    printed = capsys.readouterr().out.splitlines()
    run = ProblemRun.create(tmp_path / "run", names["search"].problem.config)
    run_generations(run, run.restore(names["Hill"]()), LocalWorkers())
    best = names["best"](run.path)
    assert printed[0] == f"{best.niche} {best.fitness} {best.error} {best.vector}"
    assert best.fitness > 0.9 and best.samples == 16


def test_giant_numbers_are_refused() -> None:
    with raises(InputError, "problem.wrong-value", "offspring"):
        ProblemConfig("hill", offspring=10**15)
