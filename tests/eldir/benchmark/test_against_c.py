"""The C program of `benchmarks/`: compiled here, it has the engine's losses, gradients and learning."""

import shutil
import subprocess
import sys
from ctypes import CDLL
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from benchmarks import by_hand, comparisons, engine
from benchmarks.task import Task, make_task
from eldir.core.kernels import Precision
from eldir.errors import EldirError
from eldir.scene import Scene
from tests.paths import ROOT

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler named cc")


@pytest.fixture(scope="module")
def task() -> Task:
    """Bodies of all sizes, so that what pads vectors differs."""
    return make_task("big", 3, 2, Scene.preset("paper").replace(steps=150))


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[Precision, CDLL]:
    """In both precisions: compiling takes two seconds."""
    folder = tmp_path_factory.mktemp("c")
    return {precision: by_hand.compile_program(folder, precision) for precision in get_args(Precision)}


@pytest.fixture
def compiled(programs: dict[Precision, CDLL], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(by_hand, "compile_program", lambda folder, precision: programs[precision])


def test_it_has_the_losses_and_gradients_of_the_engine(task: Task, programs: dict[Precision, CDLL]) -> None:
    for i, (loss, gradient) in enumerate(zip(task.losses, task.gradients, strict=True)):
        found, slopes = by_hand.gradient(programs["f64"], task, i)
        assert found == pytest.approx(loss, abs=1e-12)
        assert np.linalg.norm(slopes.flat - gradient.flat) < 1e-9 * np.linalg.norm(gradient.flat)
    assert all(len(body.springs) % 8 for body in task.bodies[:2]), "else nothing is padded"


def test_it_learns_as_the_engine_does(task: Task, programs: dict[Precision, CDLL]) -> None:
    assert by_hand.learning(programs["f64"], task)() == pytest.approx(
        engine.learning(task, "f64", 1)().losses, abs=1e-9
    )


def test_float32_is_near(task: Task, programs: dict[Precision, CDLL]) -> None:
    assert by_hand.learning(programs["f32"], task)()[:, 0] == pytest.approx(task.losses, abs=1e-5)


def test_unequal_results_are_refused(
    task: Task, compiled: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Not one of them is timed."""
    wrong = replace(task, losses=task.losses + 1e-5)
    monkeypatch.setattr(comparisons, "make_task", lambda *given: wrong)
    with pytest.raises(EldirError, match="losses of C f32 differ from those of the engine"):
        comparisons.against_c("big", 3, 1, tmp_path)


def test_a_missing_compiler_and_a_wrong_folder_are_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(EldirError, match="there is no no-such-cc"):
        by_hand.compile_program(tmp_path, "f64", compiler="no-such-cc")
    with pytest.raises(EldirError, match="this is not the released code"):
        comparisons.against_released(tmp_path, "big", 1, 1, tmp_path)
    (tmp_path / "there").mkdir()
    result = subprocess.run(
        [sys.executable, "-m", "benchmarks", "--out", str(tmp_path / "there")],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 1 and len(result.stderr.strip().splitlines()) == 1, result.stderr


def test_each_program_is_compared_in_its_own_precision(
    task: Task, compiled: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As the median of the ratios within a turn."""
    monkeypatch.setattr(comparisons, "make_task", lambda *given: task)
    programs = comparisons.against_c("big", 3, 3, tmp_path)["programs"]
    for precision in ("f32", "f64"):
        base, own = (programs[f"{name} {precision}"] for name in ("C", "engine"))
        ratios = np.array(own["seconds"]) / base["seconds"]
        assert own["times_the_base"] == pytest.approx(np.median(ratios), abs=2e-3)
        assert own["from_to"] == pytest.approx([ratios.min(), ratios.max()], abs=2e-3)
        assert base["times_the_base"] == 1


def test_the_only_form_of_a_base_serves_both_precisions() -> None:
    assert comparisons._base("released", "engine f32", {"released f64", "engine f32"}) == "released f64"
