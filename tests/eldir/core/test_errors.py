"""Errors tell programs what failed by type, code and key."""

from __future__ import annotations

import os
import re

import pytest

from calibration.camera.lens import Lens
from eldir.core.files import read_file, require_new
from eldir.core.json_text import parse_json
from eldir.core.yaml_files import parse_yaml
from eldir.errors import EldirError, InputError
from hardware.rig.configuration import Rig
from hardware.rig.template import virtual_rig
from tests.calibration.camera.lenses import lens_of
from tests.paths import ROOT

PACKAGES = ("eldir", "hardware", "calibration", "cad", "ros2_nodes")


def test_every_code_is_on_the_page_and_every_code_on_the_page_is_used() -> None:
    code = "".join(path.read_text() for name in PACKAGES for path in (ROOT / name).rglob("*.py"))
    used = set(re.findall(r'\bcode(?:: str)? ?= ?"([a-z.-]+)"', code))
    used |= {f"rig.{end}" for end in re.findall(r'code=f"\{[^}]+\}\.([a-z-]+)"', code)}
    page = (ROOT / "docs" / "reference" / "errors.md").read_text()
    listed = {
        word
        for line in page.splitlines()
        if line.startswith("| `")
        for word in re.findall("`([a-z.-]+)`", line.split("|")[1])
    }
    assert listed == used


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
    with pytest.raises(InputError) as failed:
        Rig.from_json(values)
    assert (failed.value.code, failed.value.key) == (code, key)


def test_a_record_has_code_and_key() -> None:
    values = lens_of((64, 48), [70, 71], [31, 24], [0] * 5).to_json()
    with pytest.raises(InputError) as failed:
        Lens.from_json(values | {"width_px": 0})
    assert (failed.value.code, failed.value.key) == ("camera.wrong-value", "width_px")


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
