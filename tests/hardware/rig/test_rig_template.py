"""Rig files that `eldir rig new` writes, and what the doctor says about them as they are."""

import json
import re
from collections.abc import Iterator

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from eldir.core.yaml_files import parse_yaml
from eldir_hardware.rig._board_hints import read_board_hints
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import real_rig, virtual_rig
from tests.eldir.random_design import make_design
from tests.hardware.emulated_rigs import run
from tests.paths import SCHEMAS

PRINTABLE = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"], include_characters=" "))


def entry(text: str, section: str, name: str) -> object:
    return parse_yaml(text.encode(), "rig.yaml")[section][name]


@pytest.mark.parametrize("name", ["design.json", "../walkers/robot-3.json", "/dev/serial/by-path/pci-0:1.0"])
def test_a_plain_name_stands_in_a_new_rig_file_as_it_is(name):
    assert f"  design: {name}\n" in virtual_rig(design=name)
    assert f"  port: {name}\n" in real_rig("lcus", name)


@settings(max_examples=40)
@given(PRINTABLE)
@example("robot #3.json")
@example("null")
@example("a: b")
@example("3")
@example("2026-11-24")
@example('it\'s \\ "mine"')
def test_any_printable_name_comes_back_from_a_new_rig_file(name):
    text = virtual_rig(design=name)
    assert entry(text, "virtual", "design") == yaml.load(text, yaml.CSafeLoader)["virtual"]["design"] == name
    assert Rig.from_json(parse_yaml(text.encode(), "rig.yaml")).virtual.design == name
    assert entry(real_rig("lcus", name), "board", "port") == name


@pytest.mark.parametrize("port", ["/dev/a: #b", "/dev/tty USB", "/dev/a,b", "null", "/dev/a\\b"])
def test_the_emergency_stop_reads_the_port_of_a_new_rig_file(tmp_path, port):
    assert run("new", "--board", "lcus", "--port", port, "--out", tmp_path / "rig.yaml").exit_code == 0
    assert Rig.load(tmp_path / "rig.yaml").board.port == port
    if port != "null":  # to it this word means no port
        assert read_board_hints(tmp_path / "rig.yaml").ports == (port,)


def entries(schema: dict, above: str, name: str, entry: dict) -> Iterator[tuple[str, str, dict]]:
    """Every entry below one of a schema: section, name, schema."""
    yield above, name, entry
    for section in re.findall(r"'\$ref': '#/\$defs/(\w+)'", str(entry)):
        for inner, value in schema["$defs"][section]["properties"].items():
            yield from entries(schema, section, inner, value)


def test_every_entry_is_described_in_the_schema_and_in_a_new_rig_file_with_its_default():
    """A new field of a section is one place: page, schema and new rig files are made from it."""
    schema = json.loads((SCHEMAS / "rig.schema.json").read_text())
    texts = {
        "real": real_rig("lcus", "/dev/ttyUSB0"),
        "virtual": virtual_rig(design="design.json"),
    }
    comments = {kind: " ".join(text.replace("#", "").split()) for kind, text in texts.items()}
    absent = {"real": {"VirtualEntry", "VirtualCameraEntry"}, "virtual": {"LiveCameraEntry"}}
    seen = set()
    for top, value in schema["properties"].items():
        for section, name, entry in entries(schema, "", top, value):
            seen.add(section)
            assert entry["description"], (section, name)
            for kind, comment in comments.items():
                if name == "format" or "const" in entry or section in absent[kind] or top in UNUSED[kind]:
                    continue
                assert f" {name}: {entry['description']}" in comment, (kind, section, name)
                if isinstance(entry.get("default"), str | int | float):
                    assert f"{entry['description']} Default: {entry['default']}." in comment, (section, name)
    assert seen == {"", *schema["$defs"]}


UNUSED = {"real": {"virtual"}, "virtual": set()}
"""Sections that a rig of this kind does not have."""


def test_what_a_new_rig_file_shows_as_an_example_may_be_uncommented(tmp_path):
    (tmp_path / "plane.json").write_text("{}")
    for text in (real_rig("lcus", "/dev/ttyUSB0"), virtual_rig()):
        shown = re.findall(r"^# (\w+: [^A-Z\n].*)$", text, re.MULTILINE)
        names = [line.partition(":")[0] for line in shown]
        assert {"sensor", "marker", "notify"} <= set(names)
        full = Rig.from_json(yaml.safe_load(text + "\n".join(shown).replace("/...", "/x")))
        assert full.sensor is not None and full.cutoff is not None and full.fan is not None
        assert len(full.notify) == 1 and full.camera is not None


def test_the_doctor_names_a_missing_or_damaged_design_of_a_virtual_rig(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(virtual_rig(design="robot.json"))
    result = run("doctor", "--rig", path)
    assert result.exit_code == 1
    (failed,) = [line for line in result.output.splitlines() if line.startswith("FAIL")]
    assert failed.startswith("FAIL  robot: virtual.design: ") and "robot.json" in failed
    (tmp_path / "robot.json").write_text("{}")
    assert "FAIL  robot: virtual.design: " in run("doctor", "--rig", path).output
    (tmp_path / "robot.json").unlink()
    make_design().save(tmp_path / "robot.json")
    result = run("doctor", "--rig", path)
    assert result.exit_code == 0 and "ok    robot: " in result.output
    assert "clock: " not in result.output  # nothing waits for the clock of this computer
    path.write_text(virtual_rig())
    assert "robot: " not in run("doctor", "--rig", path).output


def test_the_doctor_names_each_missing_measurement_once(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(real_rig("lcus", "/dev/no-such-port"))
    result = run("doctor", "--rig", path, "--json")
    assert result.exit_code == 1
    texts = {f["subject"]: f["text"] for f in json.loads(result.output)}
    for name in ("springs.resistance_ohm", "supply.current_limit_a"):
        assert [name in text for text in texts.values()].count(True) == 1
        assert name in texts["measurements"]
    assert "unknown until" in texts["a welded contact"]
    path.write_text(path.read_text().replace("current_limit_a: null", "current_limit_a: 3"))
    said = run("doctor", "--rig", path).output
    assert "missing in the rig file: springs.resistance_ohm; expected a measured value; measure it" in said
