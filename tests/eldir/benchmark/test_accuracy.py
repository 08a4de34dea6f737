"""The accuracy benchmark, and the settings that a scene can be asked for."""

import json
from functools import cache
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from eldir.benchmark import accuracy
from eldir.benchmark.accuracy import Case, Setting, distances, ends, pareto
from eldir.benchmark.measurement import big, save, small
from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir.learning import initial_controllers
from eldir.scene import Scene
from tests.eldir.engine.random_robots import assert_float32_is_close
from tests.paths import SCHEMAS
from tests.raised import raises

PAPER = Scene.preset("paper")


def test_accuracy_is_written_as_its_schema_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "SECONDS", 0.096)
    monkeypatch.setattr(accuracy, "STEPS", (4e-3, 2e-3))
    few = {k: v for k, v in accuracy.cases(2).items() if k in ("passive drop", "acting on ground, 3e4 N/m")}
    monkeypatch.setattr(accuracy, "cases", lambda n: few)
    monkeypatch.setitem(accuracy._REFERENCE, "dt", 4e-5)
    said: list[str] = []
    values = accuracy.measure(True, said.append)
    drawn = accuracy.plot(values)
    save(tmp_path / "out", "accuracy", values, drawn)
    written = json.loads((tmp_path / "out" / "accuracy.json").read_text())
    jsonschema.validate(written, json.loads((SCHEMAS / "benchmark-accuracy.schema.json").read_text()))
    assert (tmp_path / "out" / "accuracy.png").read_bytes().startswith(b"\x89PNG")
    assert len(said) == len(written["scenes"]) == 2
    for panel, scene in zip(drawn.axes, written["scenes"].values(), strict=False):
        front = next(line for line in panel.lines if line.get_label() == "Pareto front")
        points = {tuple(xy) for line in panel.lines if line is not front for xy in line.get_xydata()}
        assert {tuple(xy) for xy in front.get_xydata()} <= points  # it runs through markers
        assert len(front.get_xdata()) == len(scene["pareto"])
    assert len(drawn.axes) == 3  # a passive robot has no gradient, and so no panel for one
    fall = {p["name"]: p["error"] for p in written["scenes"]["passive drop"]["points"]}
    assert fall["second-order 4 ms f64"] < 0.3 * fall["paper 4 ms f64"]
    assert 3 < fall["second-order 4 ms f64"] / fall["second-order 2 ms f64"] < 5
    acting = written["scenes"]["acting on ground, 3e4 N/m"]["points"]
    printed = accuracy.describe(values)
    for name, scene in written["scenes"].items():  # the verdict by hand
        paper = next(p for p in scene["points"] if p["name"] == "paper 4 ms f32")
        met = min(e for e in (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5) if paper["error_90"] < e)
        verdict = printed.split(f"\n{name}\n")[1].split("The paper's setting")[1].splitlines()[0]
        assert f"meets {met:g} m in {paper['ms_per_robot']:.2f} ms a robot" in verdict
    assert all(np.isfinite(p["gradient_error"]) for p in acting)


def test_nothing_on_the_front_is_beaten() -> None:
    rng = np.random.default_rng(0)
    points = [{"ms_per_robot": t, "error_90": e} for t, e in rng.random((40, 2))]
    front = [points[i] for i in pareto(points)]
    for p in points:
        beats = [q for q in points if q["ms_per_robot"] < p["ms_per_robot"] and q["error_90"] < p["error_90"]]
        assert (p in front) == (not beats)


def test_a_robot_that_blew_up_is_infinitely_wrong() -> None:
    bodies = small(1, 1)
    case = Case(PAPER, bodies, initial_controllers(bodies, PAPER, 0))
    wild = Setting("paper", 4e-3, "f32").apply_to(PAPER.replace(stiffness=1e9)).replace(steps=100)
    assert np.isinf(distances(ends(case, wild), [bodies[0].positions])).all()


@pytest.mark.parametrize("error", [3e-3, 1e-3, 1e-4])
def test_the_wanted_error_is_met(error: float) -> None:
    """Robots that did not serve to tune it; tests/stress asks twenty with a finer reference."""
    case, exact = _exact()
    asked = PAPER.replace(steps=250).for_error(error)
    assert asked.dt * asked.steps == pytest.approx(1.0) and asked.integrator == "second-order"
    assert np.sum(distances(ends(case, asked), exact) <= error) >= 5


@cache
def _exact() -> tuple[Case, list[FloatArray]]:
    """Six robots, and where they truly are after a second."""
    bodies = small(6, 41)
    case = Case(PAPER, bodies, initial_controllers(bodies, PAPER, 3))
    return case, ends(case, accuracy.reference_scene(PAPER).replace(dt=2.5e-5, steps=40_000))


def test_what_a_scene_can_be_asked_for() -> None:
    assert Scene.for_error(1e-4) == PAPER.for_error(1e-4)
    assert Scene.for_error(1e-4).dt * Scene.for_error(1e-4).steps == pytest.approx(0.004 * 999)
    assert PAPER.replace(stiffness=12e4).for_error(1e-3).dt == pytest.approx(PAPER.for_error(1e-3).dt / 2)
    assert PAPER.for_error(1e-3).dt > PAPER.for_error(3e-4).dt > PAPER.for_error(1e-4).dt
    with raises(InputError, "input.wrong-value", "error"):
        Scene.for_error(1e-9)
    with raises(InputError, "scene.built"):
        Scene.preset("built").for_error(1e-3)


def test_float32_gradients_are_close_over_a_whole_run() -> None:
    """Robots of the paper's size; tests/stress has 128 of them."""
    bodies = big(8)
    assert_float32_is_close(bodies, initial_controllers(bodies, PAPER, 0), PAPER)
