"""Files that others wrote: refused in one line and in no time, whatever is in them."""

from __future__ import annotations

import json
import os
import re
import time
import tracemalloc

import pytest

from eldir.built.scene import PrintedScene
from eldir.core.files import MAX_JSON_BYTES, parse_json
from eldir.core.yaml_files import MAX_YAML_BYTES, parse_yaml
from eldir.design import Design
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir.trajectory import Trajectory
from eldir_hardware.camera.plane import TagBoard
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.schedule import ActuationSchedule
from tests.eldir.random_design import make_design
from tests.hardware.emulated_rigs import each_once
from tests.hardware.rigs_and_schedules import SCHEDULE
from tests.processor_time import in_units

LOADERS = {
    "rig": Rig.load,
    "schedule": ActuationSchedule.load,
    "design": Design.load,
    "scene": PrintedScene.load,
    "tags": TagBoard.load,
    "trajectory": Trajectory.load,
}
BOUND = 400  # units of work; the longest takes 70 (printed with -s)
RIG = virtual_rig()
LAUGHS = 'a: &a ["ha","ha","ha","ha","ha","ha","ha","ha","ha"]\n' + "".join(
    f"{y}: &{y} [{','.join(['*' + x] * 9)}]\n" for x, y in zip("abcdefgh", "bcdefghi", strict=True)
)
YAML = {
    "billion laughs": LAUGHS,
    "an alias": RIG + "x: &x 1\ny: *x\n",
    "an anchor": RIG.replace("name: virtual bench", "name: &n virtual bench"),
    "deep": "a: " + "[" * 20_000 + "]" * 20_000,
    "deep blocks": "".join(" " * i + "a:\n" for i in range(300)),
    "deep maps": "{a: " * 15_000,
    "many values": "- 1\n" * 16_000,
    "many names": "".join(f"a{i}: 1\n" for i in range(7000)),
    "too large": "#" * (MAX_YAML_BYTES + 1),
    "one long word": "a: " + "x" * (MAX_YAML_BYTES - 10),
    "one long line of quotes": 'a: "' + "\\u0041" * 10_000 + '"',
    "a name twice": RIG + "name: other\n",
    "a name twice, deeper": RIG.replace("{voltage_v: 11,", "{voltage_v: 11, voltage_v: 12,"),
    "not a number": RIG.replace("resistance_ohm: 0.987", "resistance_ohm: .nan"),
    "infinite": RIG.replace("resistance_ohm: 0.987", "resistance_ohm: 1.0e+999"),
    "a giant whole number": RIG.replace("seed: 1", "seed: 1" + "0" * 6000),
    "a giant number of minutes": RIG.replace("seed: 1\n", "seed: 1" + ":59" * 3000 + "\n"),
    "a date that is none": RIG.replace("name: virtual bench", "name: 2026-99-99"),
    "a list as a name": RIG + "[1, 2]: 3\n",
    "code": RIG.replace("name: virtual bench", "name: !!python/object/apply:os.system [true]"),
    "two documents": RIG + "---\n" + RIG,
    "a list": "[1, 2]",
    "nothing": "",
    "latin-1": "name: caf\xe9".encode("latin-1"),
    "utf-16": RIG.encode("utf-16"),
    "bytes": bytes(range(256)),
}
TEXT = json.dumps(SCHEDULE.to_json())
JSON = {
    "deep lists": "[" * 100_000 + "]" * 100_000,
    "deep objects": '{"a":' * 100_000,
    "deep, but not too deep to parse": "[" * 500 + "]" * 500,
    "many values": "[" + "1," * 3_000_000 + "1]",
    "many objects": "[" + "{}," * 2_000_000 + "{}]",
    "too large": " " * (MAX_JSON_BYTES + 1),
    "NaN": TEXT.replace('"period_s": 20.0', '"period_s": NaN'),
    "Infinity": TEXT.replace('"period_s": 20.0', '"period_s": Infinity'),
    "infinite": TEXT.replace('"period_s": 20.0', '"period_s": 1e999'),
    "a giant whole number": TEXT.replace('"period_s": 20.0', '"period_s": 1' + "0" * 4000),
    "a larger one": TEXT.replace('"period_s": 20.0', '"period_s": 1' + "0" * 100_000),
    "a name twice": TEXT.replace('"period_s": 20.0', '"period_s": 20.0, "period_s": 2.0'),
    "latin-1": TEXT.replace("front", "fr\xf6nt").encode("latin-1"),
    "utf-16": TEXT.encode("utf-16"),
    "cut": TEXT[:-10],
    "a list": "[1]",
    "a word": '"format"',
    "a list as its format": '{"format": []}',
    "nothing": "",
}


def refused(load, path, data) -> str:
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    begun = time.process_time()
    with pytest.raises(InputError) as caught:
        load(path)
    taken = time.process_time() - begun
    print(f"{path.name}: {taken:.3f} s: {caught.value}")
    assert taken < 0.2 or in_units(taken) < BOUND
    message = str(caught.value)
    assert path.name in message and "\n" not in message and len(message) < 600
    return message


@pytest.mark.parametrize("case", YAML)
def test_a_wrong_rig_file_is_refused_at_once(case, tmp_path):
    refused(Rig.load, tmp_path / "file", YAML[case])


@pytest.mark.parametrize(("case", "kind"), each_once([*JSON], [k for k in LOADERS if k != "rig"]))
def test_a_wrong_json_file_is_refused_at_once(case, kind, tmp_path):
    """One function parses them all: one case for each kind shows that it is used."""
    refused(LOADERS[kind], tmp_path / "file", JSON[case])


@pytest.mark.parametrize("kind", LOADERS)
def test_what_is_no_file_is_refused_at_once(kind, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for name in ("pipe", "folder", "link", "missing"):
        with pytest.raises(InputError, match=name):
            LOADERS[kind](tmp_path / name)
    with pytest.raises(InputError, match="pipe is not a file"):
        LOADERS[kind](tmp_path / "pipe")
    with pytest.raises(InputError):
        LOADERS[kind]("/dev/zero")


def test_errors_say_where_and_what():
    with pytest.raises(InputError, match=r"duplicate name 'voltage_v'.*line"):
        parse_yaml(YAML["a name twice, deeper"].encode(), "rig.yaml")
    with pytest.raises(InputError, match=r"anchors and aliases are not allowed.*line 1"):
        parse_yaml(LAUGHS.encode(), "rig.yaml")
    with pytest.raises(InputError, match=r"duplicate name 'period_s'"):
        parse_json(JSON["a name twice"], "schedule.json")
    for deep in ("deep lists", "deep, but not too deep to parse"):
        with pytest.raises(InputError, match="more than 64 levels"):
            parse_json(JSON[deep], "schedule.json")
    for number in (".nan", "-.inf", "1.0e+999"):
        with pytest.raises(InputError, match=r"is not a finite number in line 1"):
            parse_yaml(f"a: {number}".encode(), "rig.yaml")


@pytest.mark.parametrize("number", ["010", "-010", "1:30", "1:30.5", "0x10", "0b11", "1_000", "1_0.5"])
def test_numbers_that_yaml_reads_in_another_way_are_refused(number):
    """As 8, 90 or 1000: a rig file with `min_off_s: 010` would let springs rest for 8 s."""
    with pytest.raises(InputError, match=f"{number!r} is not a plain decimal number in line 1"):
        parse_yaml(f"a: {number}".encode(), "rig.yaml")
    for plain in (0, -7, 10, 0.5, -1.5e-3):
        assert parse_yaml(f"a: {plain!r}".encode(), "") == {"a": plain}


def test_what_is_right_is_read():
    assert parse_yaml(b"\xef\xbb\xbfa: [1, 2.5, yes, null, 'x']\nb: {c: -3}", "") == {
        "a": [1, 2.5, True, None, "x"],
        "b": {"c": -3},
    }
    values = {"a": [1, -2.5e-3, True, None, "\u00e9"], "b": {"c": 2**53}}
    assert parse_json(json.dumps(values), "") == parse_json(json.dumps(values).encode(), "") == values


DESIGN = make_design(3, Lattice(3, 6)).to_json()
LARGE = {
    "a column too many": {"lattice": {"rows": 3, "columns": 7}},
    "a thousand million columns": {"lattice": {"rows": 3, "columns": 10**9}},
    "rows without end": {"lattice": {"rows": 10**18, "columns": 6}},
    "rows that are no number of rows": {"lattice": {"rows": 1e30, "columns": 6}},
    "true rows": {"lattice": {"rows": True, "columns": 6}},
    "gravity in words": {"scene": DESIGN["scene"] | {"gravity": "nan"}},
    "true gravity": {"scene": DESIGN["scene"] | {"gravity": True}},
    "gravity of a star": {"scene": DESIGN["scene"] | {"gravity": 1e300}},
    "no gravity": {"scene": {k: v for k, v in DESIGN["scene"].items() if k != "gravity"}},
    "steps without end": {"scene": DESIGN["scene"] | {"steps": 10**15}},
    "half a step": {"scene": DESIGN["scene"] | {"steps": 9.5}},
}


@pytest.mark.parametrize("case", LARGE)
def test_a_wrong_number_in_a_design_is_refused_before_anything_is_allocated(case, tmp_path):
    """1e9 columns once took ten gigabytes."""
    tracemalloc.start()
    said = refused(Design.load, tmp_path / "design.json", json.dumps(DESIGN | LARGE[case]))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 50e6
    assert re.search(r"invalid (lattice\.|scene\.|shape of triangles)|gravity is missing", said), said


@pytest.mark.parametrize("entry", ["provenance", "genotype", "lattice"])
def test_a_missing_entry_is_named_in_words(entry, tmp_path):
    left = {k: v for k, v in DESIGN.items() if k != entry}
    said = refused(Design.load, tmp_path / "design.json", json.dumps(left))
    assert f"{entry} is missing" in said and "Error" not in said


WRONG_RIGS = {
    "voltage_v: 11": ("voltage_v: true", "invalid supply.voltage_v; expected a valid number; found True"),
    "channels: 4": ("channels: true", "invalid board.channels; expected a valid integer; found True"),
    "channel: 2,": ("channel: yes,", "invalid channels.1.channel"),
    "current_limit_a: 3.6": (
        "current_limit_a: off",
        "invalid supply.current_limit_a; expected a valid number",
    ),
    "max_on_s: 6.3": ("max_on_s: true", "invalid cutoff.timer.max_on_s"),
    "max_total_current_a: 16": ("budget_b: 16", "supply.max_total_current_a is missing"),
    "name: virtual bench": ("name: x\ncolour: red", "unknown entry colour"),
    "interlocked: true": ("interlocked: 3", "invalid fan.interlocked"),
    "supply: {": ("supply: 3 #", "invalid supply; expected named entries"),
}


@pytest.mark.parametrize("entry", WRONG_RIGS)
def test_a_wrong_entry_of_a_rig_file_is_told_in_words(entry, tmp_path):
    other, words = WRONG_RIGS[entry]
    said = refused(Rig.load, tmp_path / "rig.yaml", RIG.replace(entry, other, 1))
    assert words in said
    assert not any(leak in said for leak in ("Extra inputs", "Field required", "permitted", "Error"))


def test_true_stays_true_where_it_is_meant(tmp_path):
    (tmp_path / "rig.yaml").write_text(RIG)
    assert Rig.load(tmp_path / "rig.yaml").fan.interlocked is True
