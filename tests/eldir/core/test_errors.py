"""Errors tell programs what failed by type, code and key."""

from __future__ import annotations

import json
import os
import runpy

import pytest

from eldir.core.arguments import require_count, require_known, require_shape, require_value
from eldir.core.files import parse_json, read_file, require_new
from eldir.core.yaml_files import parse_yaml
from eldir.errors import EldirError, InputError
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.scene import Scene
from eldir_hardware.camera.lens import Lens
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from tests.hardware.camera.lenses import lens_of
from tests.paths import ROOT
from tests.raised import raises


def test_the_page_lists_every_code() -> None:
    written = runpy.run_path(str(ROOT / "docs" / "site" / "errors.py"))
    page = (ROOT / "docs" / "reference" / "errors.md").read_text()
    assert page == written["page_text"](), "run: python docs/site/errors.py"
    assert "| `file.exists` | ... exists already | `EldirError` |" in page
    assert "| `input.wrong-value` | invalid ... | `InputError` |" in page
    assert "| `stop.latched` | heating is refused until the stop is reset | `LatchedError` |" in page


@pytest.mark.parametrize(
    ("change", "code", "key"),
    [
        (lambda v: v | {"colour": "red"}, "rig.unknown-key", "colour"),
        (lambda v: {k: w for k, w in v.items() if k != "board"}, "rig.missing-key", "board"),
        (lambda v: v | {"supply": v["supply"] | {"voltage_v": "12"}}, "rig.wrong-value", "supply.voltage_v"),
        (lambda v: v | {"supply": v["supply"] | {"voltage_v": 100}}, "rig.wrong-value", "supply.voltage_v"),
        (lambda v: v | {"channels": v["channels"][:1] * 2}, "rig.inconsistent", None),
    ],
)
def test_a_wrong_rig_file_has_code_and_key(change, code, key, tmp_path) -> None:
    values = change(parse_yaml(virtual_rig().encode(), "rig.yaml"))
    with raises(InputError, code, key):
        Rig.from_json(values)


def test_a_record_has_code_and_key() -> None:
    values = lens_of((64, 48), [70, 71], [31, 24], [0] * 5).to_json()
    with raises(InputError, "camera.wrong-value", "width_px"):
        Lens.from_json(values | {"width_px": 0})


def test_what_does_not_fit_in_a_record_has_its_code(tmp_path) -> None:
    with raises(InputError, "scene.inconsistent", "Scene.precision"):
        Scene.preset("built").replace(precision="f32")
    with raises(InputError, "evolution.inconsistent", "Scene.window"):
        EvolutionConfig.from_json(
            json.loads(json.dumps(EvolutionConfig().to_json())) | {"scene": _second_order()}
        )


def _second_order() -> dict[str, object]:
    return Scene().to_json() | {"window": 9, "integrator": "second-order"}


def test_arguments_have_code_and_key() -> None:
    require_value("a", True, "b")
    require_count("a", 2, 2)
    require_shape("a", (3, 2), (9,), (None, 2))
    require_shape("a", (), ())
    require_known("a", ["b", "c"], "abc")
    with raises(InputError, "input.wrong-value", "step", match="^invalid step; expected 1 s; found 2; go$"):
        require_value("step", False, "1 s", 2, "go")
    with raises(
        InputError, "input.wrong-number", "gaits", match="^invalid number of gaits; expected 2, one for"
    ):
        require_count("gaits", 3, 2)
    with raises(InputError, "input.wrong-shape", "x", match=r"\(9\) or \(any, 2\); found \(2, 3\)$"):
        require_shape("x", (2, 3), (9,), (None, 2))
    with raises(InputError, "input.unknown-name", "crossover", match="expected a . b; found 'c', 'd'$"):
        require_known("crossover", ["a", "c", "d"], "ab")


def test_a_file_has_codes(tmp_path) -> None:
    def code(call, *arguments: object) -> str:
        with pytest.raises(EldirError) as failed:
            call(*arguments)
        return failed.value.code

    assert code(read_file, tmp_path / "none") == "file.missing"
    assert code(read_file, tmp_path) == "file.not-read"
    os.mkfifo(tmp_path / "pipe")
    assert code(read_file, tmp_path / "pipe") == "file.not-a-file"
    assert code(parse_json, b"", "x") == "file.empty"
    assert code(parse_json, b"{", "x") == "file.damaged"
    assert code(parse_json, b"1" * 99, "x", 10) == "file.too-large"
    assert code(parse_yaml, b"a: &b 1", "x") == "file.damaged"
    (tmp_path / "rig.yaml").write_text("format: eldir-design/1\n")
    assert code(Rig.load, tmp_path / "rig.yaml") == "file.other-format"
    assert code(require_new, tmp_path) == "file.exists"
    assert code(require_new, tmp_path / "a", tmp_path / "a") == "file.named-twice"
    assert code(require_new, tmp_path / "rig.yaml" / "a") == "file.not-written"
