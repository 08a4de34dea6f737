"""The scene in JAX of `benchmarks/` has the engine's losses and gradients."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import comparisons
from benchmarks.picture import table
from benchmarks.task import Task, make_task
from eldir.core.installation import describe
from eldir.errors import EldirError
from eldir.scene import Scene


@pytest.fixture(scope="module")
def task() -> Task:
    """Bodies of different sizes, so that robots are filled up."""
    return make_task("big", 3, 2, Scene.preset("paper").replace(steps=150))


@pytest.mark.stress  # JAX compiles for a quarter of a minute
def test_it_agrees_and_takes_turns(task: Task, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """`against_jax` refuses to time losses and gradients that are not the engine's."""
    monkeypatch.setattr(comparisons, "make_task", lambda *given: task)
    found = comparisons.against_jax("big", 3, 1, tmp_path)
    assert set(found["programs"]) == {"JAX f32", "JAX f64", "engine f32", "engine f64"}
    assert found["programs"]["JAX f64"]["loss_error_m"] < 1e-12
    compared = {"JAX, big robots": found | {"load_average": [0.0, 0.0]}}
    told = table({"measured": "today", "machine": describe(), "comparisons": compared})
    assert told.count("first turn, with compiling") == 2


@pytest.mark.stress
def test_unequal_gradients_are_refused(task: Task, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    turned = [c.shaped(c.flat + 0.1 * np.linalg.norm(c.flat) / np.sqrt(c.flat.size)) for c in task.gradients]
    monkeypatch.setattr(comparisons, "make_task", lambda *given: replace(task, gradients=turned))
    with pytest.raises(EldirError, match="gradients of JAX f32 differ from those of the engine"):
        comparisons.against_jax("big", 3, 1, tmp_path)


def test_what_a_program_gets_and_gives_back(task: Task, tmp_path: Path) -> None:
    task.save(tmp_path / "task.npz")
    with np.load(tmp_path / "task.npz") as saved:
        assert saved["steps"] == 150 and saved["ground"] == pytest.approx(0.1)
        assert all((saved[f"start{i}"] == task.start(i)).all() for i in range(3))
    replace(task, controllers=task.gradients).save(tmp_path / "gradients.npz")
    found = task.saved_gradients(tmp_path / "gradients.npz")
    assert (comparisons._gradient_errors(task, found) == 0).all()
    longer = [c.shaped(1.5 * c.flat) for c in found]
    assert comparisons._gradient_errors(task, longer) == pytest.approx([0.5] * 3)


def test_without_jax_it_ends_in_one_line(task: Task, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(comparisons, "make_task", lambda *given: task)
    (tmp_path / "jax.py").write_text("raise ModuleNotFoundError(\"No module named 'jax'\")")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(EldirError, match="No module named 'jax'"):
        comparisons.against_jax("big", 3, 1, tmp_path)
