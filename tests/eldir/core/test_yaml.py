"""The one reader and writer of YAML."""

import re
import string
from math import isfinite
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.core.yaml_files import dump_yaml, parse_foreign_yaml, parse_yaml, with_entries, with_section
from eldir.errors import InputError
from eldir_hardware.rig.template import real_rig, virtual_rig
from tests.raised import raises

ROOT = Path(__file__).resolve().parents[3]
RIGS = {
    "virtual": virtual_rig(),
    "with a robot": virtual_rig(board="mosfet", design="design.json"),
    "real": real_rig("lcus", "/dev/ttyUSB0"),
}
FILES = (
    "cad/eldir_cad/kit/data/parts.yaml",
    "cad/eldir_cad/kit/data/xip.yaml",
    "ros2_nodes/eldir_ros/config/rig.yaml",
)
WORDS = """
yes no on off y n Y N Yes TRUE ~ null 1e-3 1.0e-3 1e3 1.5e3 .5 -.5 -0 +1 017 0o17 0x1F 0b1 1_000 1:30 1:30.5
2026-11-26 2026-11-26T10:11:12Z << = - a:b camera:0 /dev/ttyUSB0 .inf -.INF .NaN ? : | > % @ `
"""
LETTERS = st.characters(codec="utf-8", exclude_characters="\x85\u2028\u2029")
"""PyYAML writes the other three ends of a line so that they come back as a space."""
SCALARS = (
    st.sampled_from(WORDS.split())
    | st.text("0123456789+-.eE_:xonyf", max_size=7)
    | st.text(LETTERS, max_size=6)
)
# Compiled code may have made this process take subnormal numbers for 0.
NUMBERS = st.integers(-(10**6), 10**6) | st.floats(-1e9, 1e9, allow_subnormal=False)
VALUES = st.recursive(
    SCALARS | NUMBERS | st.booleans() | st.none(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(SCALARS, inner, max_size=3),
    max_leaves=8,
)


def read(text: str):
    """As PyYAML's own reader, which splits the text in Python, has it; None for what it refuses."""
    try:
        return [yaml.safe_load(text)]
    except (yaml.YAMLError, ValueError):
        return None


@pytest.mark.parametrize("name", [*RIGS, *FILES])
def test_our_files_are_read_as_by_the_reader_in_python(name):
    text = RIGS[name] if name in RIGS else (ROOT / name).read_text()
    assert parse_yaml(text.encode(), "") == yaml.safe_load(text)


@given(SCALARS, st.sampled_from(("a: {}", "a: [{}, b]", "{{a: {}}}", "a: '{}'")))
def test_words_mean_what_they_mean_to_the_reader_in_python(word, frame):
    """Or are refused: a number that YAML 1.1 reads in another way than a person."""
    text = frame.format(word)
    try:
        ours = parse_yaml(text.encode(), "")
    except InputError as error:
        assert error.code == "file.damaged"
        return
    wanted = read(text)
    if wanted is None:  # libyaml takes more, such as tabs
        return
    assert repr(ours) == repr(wanted[0]) or word.strip(string.whitespace) == "!" or "\ufeff" in word


@given(VALUES)
@settings(max_examples=60)
def test_what_is_written_is_read_again(values):
    assert parse_foreign_yaml(dump_yaml(values).encode(), "", "") == values


LAYOUTS = {
    "block": "a: 1 # one\n\n# of s\ns:\n  # of x\n  x: 1   # ex\n  y: [1,\n    2]  # why\n# of b\nb: 2\n",
    "at the end": "a: 1\ns:\n    x: 1   # ex",
    "nested": "s:\n  x: 'old'\n  t:\n    u:\n    - 1\n    - v: 2  # vee\na: 1\n",
    "flow": "a: 1\ns: {x: 1, # ex\n y: 2,} # s\nb: 2\n",
    "none": "a: 1 # one\nb: 2\n",
    "without a value": "a: 1\ns:   # nothing yet\nb: 2\n",
    "null": "s: null\n",
    "no brackets' content": "s: {}\n",
    "an entry without a value": "s:\n  x:\n  y: 2\n",
    "like JSON": '{"a": 1, "s": {"x": 1}, "b": [2]}',
    "other letters": "é: 'ü😀'\ns: {x: 'ü'}\n",
    "indented": "  a: 1\n  s:\n     x: 1\n",
}


@given(
    st.sampled_from(sorted(LAYOUTS)),
    st.dictionaries(st.sampled_from(("x", "y", "z")), SCALARS | NUMBERS.filter(isfinite), min_size=1),
)
@settings(max_examples=150)
def test_an_entry_is_set_and_the_rest_stays(layout, entries):
    """Values as given, also words that YAML 1.1 reads as something else."""
    before = LAYOUTS[layout]
    after = with_entries(before, "s", entries)
    wanted = yaml.safe_load(before)
    wanted["s"] = (wanted["s"] or {}) | entries if "s" in wanted else entries
    assert yaml.safe_load(after) == wanted
    comments = [line[line.index("#") :] for line in before.splitlines() if "#" in line]
    assert all(comment in after for comment in comments)


@pytest.mark.parametrize("text", RIGS.values(), ids=RIGS)
def test_only_the_entry_of_a_rig_file_changes(text):
    after = with_entries(text, "limits", {"max_temperature_c": 85.5})
    assert after == text.replace("max_temperature_c: 90", "max_temperature_c: 85.5")
    after = with_entries(text, "board", {"retriggerable": True})
    lines = after.splitlines()
    lines.remove("  retriggerable: true")
    assert lines == [line for line in text.splitlines() if "  retriggerable:" not in line or "#" in line]


@given(
    st.sampled_from(sorted(LAYOUTS)),
    st.one_of(
        SCALARS, st.lists(st.fixed_dictionaries({"x": SCALARS})), st.dictionaries(st.just("x"), SCALARS)
    ),
)
@settings(max_examples=100)
def test_a_section_is_replaced_and_the_rest_stays(layout, value):
    before = LAYOUTS[layout]
    after = with_section(before, "s", value)
    assert yaml.safe_load(after) == yaml.safe_load(before) | {"s": value}
    assert after.startswith(re.split(r'"?\bs"?:', before)[0].rstrip())


def test_an_example_in_a_comment_becomes_the_section():
    text = RIGS["real"]
    after = with_section(text, "fan", {"interlocked": False})
    assert after == text.replace("# fan: {interlocked: true}", "fan: {interlocked: false}")
    rows = [{"channel": 2, "spring": 0, "face": "both"}, {"channel": 1, "spring": 1, "face": "both"}]
    after = with_section(text, "channels", rows)
    begin, end = text.index("  - {channel: 1"), text.index("\n\n# supply:")
    block = "  - {channel: 2, spring: 0, face: both}\n  - {channel: 1, spring: 1, face: both}"
    assert after == text[:begin] + block + text[end:]
    assert with_section(after, "channels", parse_yaml(text.encode(), "")["channels"]) == text


def test_what_cannot_be_set_is_refused_with_what_to_write():
    with pytest.raises(InputError, match=r"yourself: \{s: \{y: 2\}\}"):
        with_entries("s:\n  x: |\n    a\n    b\nc: 1\n", "s", {"y": 2})


def test_a_deep_text_of_another_program_is_refused():
    with pytest.raises(InputError) as error:
        parse_foreign_yaml(b"[" * 10_000, "metadata.yaml", "name the log")
    assert error.value.code == "file.damaged" and "name the log" in str(error.value)


def test_what_is_no_yaml_is_named_with_its_line():
    with raises(InputError, "file.damaged") as error:
        parse_yaml(b"kind: [real\n", "rig.yaml")
    begin = "rig.yaml is damaged; expected YAML; found an error: did not find"
    assert str(error.value).startswith(begin) and str(error.value)[-1] not in "; "
