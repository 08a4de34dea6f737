"""Films of robots with hubs: pins leave more than noise, hubs do not; and which models are tried when."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from eldir.built.samples import IdentifiedRobots
from eldir.built.scene import PrintedScene
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import QUANTITIES, RobotParameters
from eldir_calibration.dynamics import _model_search
from eldir_calibration.dynamics._fits import DynamicsFit
from eldir_calibration.dynamics._model_check import ModelCheck, check_model
from eldir_calibration.dynamics._model_search import CandidateModel, ModelSearch
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.dynamics.recording import NOT_MEASURED, Recording, predict_markers
from eldir_calibration.dynamics.results import STOPPED, identify_robot
from eldir_calibration.dynamics.verdict import describe_model, within_noise
from tests.calibration.dynamics.hidden_rigs import QUICK, SOFT, film, walker
from tests.eldir.built.filmed_walker import TRUTH
from tests.paths import SCHEMAS

HUBS = replace(SOFT, printed=SOFT.printed.with_hubs())
CLAMPED = RobotParameters(BuiltParameters.clamped())
OFF = {"hot_length": 0.4, "socket_friction": 1.0}


def test_hubs_explain_what_pins_leave() -> None:
    """In a short film; `make stress` lets the search find them, and so does the demo in its own film."""
    truth = HUBS.at(tuple(OFF), list(OFF.values()))
    seen = film(walker(), truth, 3, 2, period=8.0)
    pins = SOFT.at(("hot_length",), [OFF["hot_length"]])
    hubs, other = (check_model([seen], predict_markers(walker(), [seen], [r])[0]) for r in (truth, pins))
    assert within_noise(hubs)
    assert not within_noise(other) and other.unexplained > 5 * hubs.unexplained


@pytest.mark.stress
def test_hubs_are_found_where_pins_leave_more_than_noise(tmp_path: Path) -> None:
    truth = HUBS.at(tuple(OFF), list(OFF.values()))
    seen = film(walker(), truth, 3, 2)
    scene = identify_robot(walker(), [seen], SOFT, others=[HUBS, CLAMPED], names=tuple(OFF), config=QUICK)
    model = scene.results.to_json()["model"]
    pins, hubs = model["tried"]
    assert (pins["strips"], pins["fits"]) == ("pinned", False) and model["strips"] == hubs["strips"] == "hubs"
    assert hubs["fits"] and hubs["unexplained_m"] < 0.1 * pins["unexplained_m"]
    for name, error in (("hot_length", 0.005), ("socket_friction", 0.1)):
        true = QUANTITIES[name].value(truth)
        assert QUANTITIES[name].value(scene.robot) == pytest.approx(true, rel=error), name
    held = scene.results.to_json()["held_out_cycle"]
    assert held["error_after"] < 0.01 and held["error_before"] > 5 * held["error_after"]
    said = describe_model(scene.results.model)
    assert said[0].startswith("model: hubs with sockets;") and "with pinned strips" in said[0]
    assert "the film chose hubs with sockets, so no value counts as known" in said[-1]
    scene.save(tmp_path / "scene.json")
    saved = json.loads((tmp_path / "scene.json").read_text())
    jsonschema.validate(saved, json.loads((SCHEMAS / "built-scene.schema.json").read_text()))
    loaded = PrintedScene.load(tmp_path / "scene.json")
    assert loaded == scene and loaded.parameters == tuple(OFF)
    around = IdentifiedRobots(
        walker().morphology, loaded.robot, parameters=loaded.parameters, covariance=loaded.covariance
    )
    drawn = around.sample(np.random.default_rng(0)).printed
    assert drawn.joints == "hubs" and drawn.socket_friction != loaded.robot.printed.socket_friction


def check(unexplained: float) -> ModelCheck:
    """Residuals of which noise does not explain so much [mm]; 0.05 mm count as none."""
    smooth = np.full((2, 5), 1e-3 * unexplained)
    kept = (np.ones(10, bool),)
    return ModelCheck(("a", "b", "c", "d", "e"), smooth, 1.5e-4, 2e-4, 5e-5, 1e-2, kept, (0.0,))


def tried(
    left: dict[str, float], recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> tuple[list[str], list[str]]:
    """Joints of the models that were tried where each leaves so much [mm] ("parts": with parts), and what was
    said on the way."""

    def fitted(parts: bool) -> Callable[..., DynamicsFit]:
        def fit(body: object, films: object, nominal: RobotParameters, *_: object, **kw: Any) -> DynamicsFit:
            kw["progress"]("fit", 0.5)
            found = check(left["parts" if parts else nominal.printed.joints])
            names: Sequence[str] = ("hot_length", "strip 0") if parts else ("hot_length",)
            z = np.zeros(len(names))
            small = (1e-4, 1e-4)
            return DynamicsFit(tuple(names), z, np.eye(len(z)), small, small, 1, z, found)

        return fit

    def judged(
        body: object, film: object, nominal: RobotParameters, fit: DynamicsFit, supposed: bool, config: Any
    ) -> CandidateModel:
        return CandidateModel(nominal, fit, fit.check, supposed, config=config)

    for name in ("fit_dynamics", "fit_joints"):
        monkeypatch.setattr(_model_search, name, fitted(False))
    monkeypatch.setattr(_model_search, "fit_parts", fitted(True))
    monkeypatch.setattr(CandidateModel, "of", judged)
    said: list[str] = []
    search = ModelSearch(
        walker(), [recording], ("hot_length",), NOT_MEASURED, 0, lambda what, _: said.append(what),
        DEFAULT_CONFIG,
    )  # fmt: skip
    found = list(search.models(SOFT, [HUBS, CLAMPED]))
    return [c.nominal.printed.joints + " with parts" * c.has_own_parts for c in found], said


@pytest.mark.parametrize(
    ("left", "expected"),
    [
        ({"pins": 0.04}, "pins"),
        ({"pins": 0.3, "hubs": 0.04}, "pins, hubs"),
        ({"pins": 0.3, "hubs": 0.14, "parts": 0.1}, "pins, hubs, hubs with parts"),
        ({"pins": 0.3, "hubs": 0.2, "clamped": 0.04}, "pins, hubs, clamped"),
        ({"pins": 0.3, "hubs": 0.29, "clamped": 0.9, "parts": 0.1}, "pins, hubs, clamped, pins with parts"),
        ({"pins": 3.0, "hubs": 2.9, "clamped": 1.0, "parts": 0.9}, "pins, hubs, clamped, clamped with parts"),
    ],
)
def test_costly_models_are_tried_only_where_cheap_ones_do_not_explain(
    left: dict[str, float], expected: str, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, said = tried(left, recording, monkeypatch)
    assert found == expected.split(", ")
    assert said == [f"{'parts' if 'parts' in name else name}, fit" for name in found], "progress"


def test_ctrl_c_keeps_the_models_that_were_fitted(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C while the second model is fitted, and while the first is."""

    def interrupted(*_: object, **__: object) -> DynamicsFit:
        raise KeyboardInterrupt

    names, quick = ("hot_length",), replace(QUICK, starts=1)
    whole = identify_robot(walker(), [recording], TRUTH, names=names, config=quick)
    assert STOPPED not in whole.provenance
    monkeypatch.setattr(ModelSearch, "_is_explained", lambda *_: False)
    monkeypatch.setattr(_model_search, "fit_joints", interrupted)
    others = [replace(TRUTH, printed=TRUTH.printed.with_hubs())]
    kept = identify_robot(walker(), [recording], TRUTH, others=others, names=names, config=quick)
    assert replace(kept, provenance={}) == whole and kept.provenance == {STOPPED: True}
    monkeypatch.setattr(_model_search, "fit_dynamics", interrupted)
    with pytest.raises(KeyboardInterrupt):
        identify_robot(walker(), [recording], TRUTH, others=others, names=names, config=quick)
