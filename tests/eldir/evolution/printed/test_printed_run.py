"""Runs of printed robots: the same bytes however they were interrupted, and robots that walk as promised."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import cv2
import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.built.gait import read_gait
from eldir.built.robot import build
from eldir.built.samples import NominalRobots, sample_walks
from eldir.core.records import FloatArray
from eldir.errors import EldirError, InputError
from eldir.evolution import designs as designs_of_runs
from eldir.evolution import load_run, tables
from eldir.evolution.loop import run_generations
from eldir.evolution.printed.analysis import archive_figure
from eldir.evolution.printed.best_walks import printed_walks
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.problem import Candidate, PrintedProblem
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.printed.trials import (
    FRESH,
    LANES,
    compare_gaits,
    evaluate_walks,
    screen_gaits,
)
from eldir.evolution.printed.walker import Niche
from eldir.evolution.problem import Part, TrialPart
from eldir.evolution.search import Search
from eldir.evolution.status import read_status
from eldir.evolution.workers import LocalWorkers
from eldir.lattice import Lattice
from eldir.learning import learn
from eldir.morphology import Morphology
from eldir.parameters.tolerances import RigTolerances
from eldir.scene import Scene
from eldir_app.application import application
from tests.eldir.evolution.evolve_processes import contents, start
from tests.eldir.evolution.printed.small_searches import SMALL, edges, genomes
from tests.made_once import made_once
from tests.paths import SCHEMAS
from tests.phone_screen import BROWSER, measured
from tests.raised import raises

pytestmark = pytest.mark.slow(50)

TINY = [
    "--objective",
    "printed",
    "--lattice",
    "4x7",
    "--population",
    "4",
    "--seed",
    "2",
]


class Course(NamedTuple):
    """What was noted of a run of two generations whose walks are invented: every robot walks."""

    shown: list[tuple[float, str]]
    """How far it was, in generations, and its line of progress."""
    judged: list[tuple[Callable, int]]
    """Kinds of trial in their order, and how many robots each had."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete run of two generations, by the command, on one thread as `make test` has it."""

    def run() -> Path:
        folder = tmp_path_factory.mktemp("runs") / "run"
        words = ["evolve", "--out", str(folder), "--generations", "1", *TINY]
        result = CliRunner().invoke(application("evolve"), words)
        assert result.exit_code == 0, result.output
        return folder

    return made_once(tmp_path_factory, "printed run", run)


@pytest.fixture(scope="module")
def course(tmp_path_factory: pytest.TempPathFactory) -> Course:
    def run() -> Course:
        noted = Course([], [])

        class Invented(LocalWorkers):
            def __call__(self, parts: Iterable[Part]) -> Iterator[tuple[Part, FloatArray]]:
                for part in parts:
                    assert isinstance(part, TrialPart)
                    noted.judged.append((part.trial, len(part.tasks)))
                    shape = {screen_gaits: LANES, evaluate_walks: FRESH}.get(part.trial, 2)
                    seeds = [np.random.default_rng(t.seed) for t in part.tasks]
                    yield part, np.array([rng.uniform(0.9, 1.1, shape) for rng in seeds])

        folder = PrintedRun.create(tmp_path_factory.mktemp("course") / "run", replace(SMALL, generations=1))
        search = folder.restore()

        def progress(share: float) -> None:
            noted.shown.append((search.generation + share, folder.progress_line(search)))

        run_generations(folder, search, Invented(), progress=progress)
        assert search.finished
        return noted

    return made_once(tmp_path_factory, "printed course", run)


def test_threads_and_interruptions_do_not_matter(whole: Path, tmp_path: Path) -> None:
    """The generation with elites again, on three threads. Ctrl-C and all else that ends a run is tested with
    the paper's robots, whose generations are shorter, and with own problems."""
    stopped = tmp_path / "run"
    shutil.copytree(whole, stopped)
    for last in ("generation", "archive"):
        (stopped / f"{last}-0001.parquet").unlink()
    assert "stopped, 1 of 2 generations, 24 robots tried" in read_status(PrintedRun.open(stopped)).summary()
    again = start("--resume", stopped, "--json", threads=3)
    told = json.loads(again.communicate()[0])
    assert again.returncode == 0 and told["state"] == "finished"
    jsonschema.validate(told, json.loads((SCHEMAS / "printed-status.schema.json").read_text()))
    assert contents(stopped) == contents(whole)
    said = CliRunner().invoke(application("status"), ["status", str(stopped)]).output
    assert "finished, 2 of 2 generations, " in said


def test_designs_carry_a_gait_and_walk_in_it_as_promised(whole: Path) -> None:
    run = PrintedRun.open(whole)
    jsonschema.validate(
        json.loads((whole / "run.json").read_text()),
        json.loads((SCHEMAS / "printed-run.schema.json").read_text()),
    )
    designs, elites = load_run(whole), run.read_last_elites()
    assert len(designs) == len(elites) > 0
    best = designs[0]
    gait, told = read_gait(best), best.provenance["evolved_walk"]
    assert gait is not None and gait.method == "evolved"
    assert (gait.period, round(gait.period * gait.duty[0], 6)) in run.config.timings
    assert told["expected"] == pytest.approx(elites[0].walks.mean()) and told["samples"] == len(
        elites[0].walks
    )
    robots = NominalRobots(best.morphology, run.config.nominal)
    (fresh,) = sample_walks(robots, [gait], 16, seed=99)
    away = np.hypot(fresh.error, told["standard_error"]) + 0.02
    assert abs(fresh.expected - told["expected"]) < 4 * away, "other samples walk as far"


def test_controllers_are_taught_for_the_papers_comparison(whole: Path) -> None:
    designs = load_run(whole)
    trained = learn([d.morphology for d in designs], Scene(), seed=[d.provenance["seed"] for d in designs])
    assert [d.controller for d in designs] == list(trained.controllers)
    assert [d.provenance["fitness_m"] for d in designs] == (-trained.losses.min(axis=1)).tolist()
    assert load_run(whole, count=1) == designs[:1], "taught alone, the best one has the same controller"


def test_what_is_shown_of_the_progress_never_goes_back(course: Course) -> None:
    done, lines = zip(*course.shown, strict=True)
    assert list(done) == sorted(done) and done[-1] == 2
    numbers = [int(line.split()[1].rstrip(",")) for line in lines if line.startswith("generation ")]
    assert numbers and numbers == sorted(numbers) and set(numbers) == {0, 1}


def test_what_the_workshop_refuses_is_not_tried() -> None:
    def refused(body: Morphology) -> str:
        return "too wide" * (len(body.positions) > 8)

    problems = [PrintedProblem(SMALL, said) for said in (refused, lambda body: "")]
    tried = [problem.random(0, np.random.default_rng(3)) for problem in problems]
    small, all_sizes = ([len(c.body.positions) for c in found] for found in tried)
    assert len(small) == len(all_sizes) == 24
    assert max(small) <= 8 < max(all_sizes)


def test_twice_as_many_random_robots_as_offspring_are_looked_at_closely(course: Course) -> None:
    """The second generation has elites to descend from: otherwise it would be 24 random robots again."""
    second = course.judged.index((screen_gaits, 4))
    first, later = course.judged[:second], course.judged[second:]
    assert first[:2] == [(screen_gaits, 24), (compare_gaits, 4)] and screen_gaits not in [
        kind for kind, _ in first[1:]
    ]
    assert max(n for kind, n in later if kind is compare_gaits) <= 2


def test_a_body_is_shown_to_the_workshop_once() -> None:
    shown: list[Morphology] = []
    problem = PrintedProblem(SMALL, lambda body: shown.append(body) or "")
    for seed in range(3):
        problem.random(0, np.random.default_rng(seed % 2))
    assert len({body.key for body in shown}) == len(shown) > 24


def test_a_workshop_that_refuses_all_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eldir.evolution.printed.problem._ATTEMPTS", 5)
    run = PrintedRun.create(tmp_path / "run", SMALL)
    with raises(EldirError, "evolution.too-few-bodies", match="expected 24 different bodies; found 0"):
        run.restore(lambda body: "too wide").ask()
    assert "best" not in read_status(run).summary()


def test_a_mirror_image_must_be_buildable_too() -> None:
    genome = genomes(200, 7)[36]
    walks = np.array([[-0.1, 0.0, -0.3, -0.5, 0.0, -0.3, 0.0, 0.0]])
    candidates = [Candidate(0, -1, genome, genome.body(SMALL.lattice), 0)]
    for said in ("", "too wide"):
        problem = PrintedProblem(SMALL, lambda body, said=said: said)
        trials = problem.screening_trials(candidates)
        assert len(problem.select_promising(candidates, trials, walks, 2)) == (said == "")


@pytest.mark.parametrize("forward", [True, False])
def test_a_backward_walker_goes_on_as_its_mirror_image(forward: bool) -> None:
    """Judged by a stand-in for the first trial; that the image walks the other way is tested with physics."""
    problem, genome = PrintedProblem(SMALL), genomes(200, 7)[36]
    walks = np.array([[0.1, 0.0, -0.1, 0.5, 0.0, 0.3, 0.0, 0.0]])
    body = genome.body(SMALL.lattice)
    candidates = [Candidate(0, -1, genome, body, 0)]
    trials = problem.screening_trials(candidates)
    ((candidate, trial),) = problem.select_promising(candidates, trials, walks if forward else -walks, 2)
    assert trial.body is candidate.body
    assert (
        edges(candidate.body)
        == edges(body, 1.0 if forward else -1.0)
        != edges(body, -1.0 if forward else 1.0)
    )
    own = genome.gait(body, SMALL.timings)
    lanes = [(own.phase[1] + k / 8) % 1.0 for k in (3, 5)]
    turned = {round(min(p, 1 - p), 9) for p in lanes}  # the other motor may be the first one there
    assert {round(min(g.phase[1], 1 - g.phase[1]), 9) for g in trial.gaits} == turned


def test_damaged_files_are_named(whole: Path, tmp_path: Path) -> None:
    run = PrintedRun.create(tmp_path / "run", SMALL)
    with raises(InputError, "run.no-generation"):
        load_run(run.path)
    (run.path / "archive-0000.parquet").write_bytes(b"PAR1 is not enough")
    with raises(InputError, "file.damaged", match=r"archive-0000\.parquet"):
        run.restore()
    (run.path / "run.json").write_text('{"format": "eldir-log/1"}')
    with raises(InputError, "file.other-format"):
        load_run(run.path)


@pytest.mark.parametrize(
    ("name", "wrong", "code", "key"),
    [
        ("offspring", 1, "wrong-value", "offspring"),
        ("generations", -1, "wrong-value", "generations"),
        ("max_active", 9, "wrong-value", "max_active"),
        ("static_margin", float("nan"), "wrong-value", "static_margin"),
        ("timings", (), "inconsistent", "PrintedEvolutionConfig.timings"),
        ("timings", ((5.0, 6.0),), "inconsistent", "PrintedEvolutionConfig.timings"),
    ],
)
def test_configurations_that_make_no_sense(name: str, wrong: object, code: str, key: str) -> None:
    with raises(InputError, f"printed-evolution.{code}", key):
        replace(SMALL, **{name: wrong})
    assert PrintedEvolutionConfig.from_json(SMALL.to_json()) == SMALL


def test_a_run_has_the_tolerances_of_its_rig() -> None:
    """A run without them is written as before they were in the file, and both are read."""
    assert replace(SMALL, tolerances=RigTolerances()) == SMALL and "tolerances" not in SMALL.to_json()
    narrow = replace(SMALL, tolerances=RigTolerances(0.01, 0.08, 21.0, 23.0))
    assert narrow.to_json() == SMALL.to_json() | {"tolerances": narrow.tolerances.to_json()}
    assert PrintedEvolutionConfig.from_json(narrow.to_json()) == narrow != SMALL
    batch = PrintedProblem(narrow).evaluate(PrintedProblem(narrow).random(0, np.random.default_rng(3)), [])
    assert next(batch).arguments == (narrow.nominal, narrow.tolerances)


def test_bodies_that_never_stand_end_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eldir.evolution.printed.problem._ATTEMPTS", 5)
    impossible = replace(SMALL, lattice=Lattice(1, 1), static_margin=0.027)
    with raises(EldirError, "evolution.too-few-bodies"):
        Search(PrintedProblem(impossible)).ask()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--objective", "printed", "--terrain", "hills"], "hills"),
        (["--objective", "printed", "--iterations", "9"], "remove --iterations"),
        (["--rig", "rig.yaml"], "--rig is only for --objective printed"),
        (["--objective", "prnted"], "prnted"),
    ],
)
def test_wrong_arguments_leave_nothing(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = CliRunner().invoke(application("evolve"), ["evolve", "--out", "run", *arguments])
    assert found.exit_code == 2 and said in " ".join(found.output.replace("│", "").split()), found.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["--max-motors", "--population"])
def test_more_motors_than_the_rig_heats_or_too_few_robots(option: str, tmp_path: Path) -> None:
    found = CliRunner().invoke(
        application("evolve"),
        ["evolve", "--objective", "printed", option, "3", "--out", str(tmp_path / "run")],
    )
    assert found.exception.key == option
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def analysed(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `eldir analyse` writes for the run. That a run gives the same bytes: `test_analysis.py`."""
    out = tmp_path_factory.mktemp("analysed") / "figures"
    found = CliRunner().invoke(application("analyse"), ["analyse", str(whole), "--out", str(out)])
    assert found.exit_code == 0, found.output
    return out


def test_analyse_draws_such_runs(whole: Path, analysed: Path) -> None:
    """Every figure can be seen, and the tables hold the archive's numbers."""
    out = analysed
    page = (out / "index.html").read_text()
    linked = set(re.findall(r'(?:src|href)="([^"]+)"', page))
    pictures = {p.name for p in out.glob("*.png")}
    assert {p.name for p in out.iterdir()} == linked | pictures | {"index.html"} and len(pictures) == 6
    assert all(cv2.imread(str(out / name)).std() > 3 for name in pictures)
    run = PrintedRun.open(whole)
    elites = run.read_last_elites()
    rows = list(csv.DictReader((out / "elites.csv").read_text().splitlines()))
    assert [int(row["id"]) for row in rows] == [w.number for w in elites]
    for row, walker in zip(rows, elites, strict=True):
        body = walker.genome.body(run.config.lattice)
        gait = walker.genome.gait(body, run.config.timings)
        assert float(row["expected"]) == pytest.approx(walker.walks.mean(), rel=1e-6)
        length = 57 * np.ptp(body.positions[:, 0]) / 0.05  # the printed pitch, not that of the lattice
        assert float(row["width_mm"]) == pytest.approx(length, rel=1e-6)
        five = 5 * float(row["mm_per_cycle"])
        assert five == pytest.approx(length * walker.expected, rel=1e-5)
        five_take = 5 * gait.period / 60
        assert float(row["mm_per_minute"]) * five_take == pytest.approx(five, rel=1e-5)
    generations = list(csv.DictReader((out / "generations.csv").read_text().splitlines()))
    assert [int(row["tried"]) for row in generations] == [24, 4]
    assert max(float(row["best_first_estimate"] or 0) for row in generations) > 0


@pytest.mark.skipif(BROWSER is None, reason="Chromium is not installed")
def test_no_table_of_such_a_page_is_cut_off_without_a_word(analysed: Path, tmp_path: Path) -> None:
    found = measured(analysed / "index.html", 390, tmp_path, "walk")
    assert len(found["heads"]) == 1 and found["page"] <= found["width"]
    assert found["cut"] == []


def test_the_best_robots_of_the_figure_are_those_of_the_first_estimates(whole: Path) -> None:
    run = PrintedRun.open(whole)
    first, last = printed_walks(run, 2)
    assert [first.generation, last.generation] == [0, 1]
    walks = tables.rows(tables.read(run.generation_file(0), ["walks"]), "walks")
    place = int(np.argmax([own.mean() if len(own) > 1 else -np.inf for own in walks]))
    genome = run.read_genome(0, place)
    assert (genome.body(run.config.lattice).springs == first.body.springs).all()
    walked = float(first.result.split()[0])  # and its own nominal walk, by the mean of its hubs
    robot = build(first.body, run.config.printed)
    assert walked == pytest.approx(
        np.diff(first.positions[[0, -1]].mean(axis=1)[:, 0])[0] / robot.body_length, abs=0.03
    )


def test_kinds_of_one_length_have_one_tick() -> None:
    walker = SimpleNamespace(niche=Niche(rows=1, length=2, masses=6, grounded=1), expected=1.5)
    figure = archive_figure([SimpleNamespace(walker=walker)])
    for axis in (figure.axes[0].xaxis, figure.axes[0].yaxis):
        low, high = axis.get_view_interval()
        assert [t for t in axis.get_majorticklocs() if low <= t <= high] == [round((low + high) / 2)]


def test_a_run_without_a_walker_has_no_figures(tmp_path: Path) -> None:
    PrintedRun.create(tmp_path / "run", SMALL)
    found = CliRunner().invoke(
        application("analyse"), ["analyse", str(tmp_path / "run"), "--out", str(tmp_path / "out")]
    )
    assert "has no robot that walks yet" in str(found.exception) and not (tmp_path / "out").exists()


def test_only_the_best_become_designs(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(PrintedRun.open(whole).read_last_elites()) > 1
    monkeypatch.setattr(designs_of_runs, "_MAX_PRINTED", 1)
    assert len(load_run(whole)) == 1
