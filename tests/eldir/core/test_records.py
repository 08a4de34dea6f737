"""Records: a field says its type, range, unit and meaning once; what reads and writes follows."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import Field

from eldir.core.records import OMITTED, Array, BoolArray, FileRecord, FloatArray, IntArray, Record, record
from eldir.core.validation import adapter, validate
from eldir.errors import InputError

# Compiled code may have made this process take subnormal numbers for 0.
FINITE = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False)


@record
class Supply(Record):
    """A supply."""

    OPTIONAL = frozenset({"name"})

    volts: Annotated[float, Field(alias="voltage_v", gt=0)] = 11.0
    """Voltage [V]."""
    name: str = "bench"
    """Name."""

    @classmethod
    def upgrade(cls, values: dict[str, Any]) -> dict[str, Any]:
        return {
            "voltage_v" if name == "u" else name: value for name, value in super().upgrade(values).items()
        }


@dataclass(frozen=True, eq=False)
class Mask(Record):
    """A dataclass of the standard library in a record."""

    bits: Annotated[BoolArray, Array("?", None)]
    """Bits."""

    def __post_init__(self) -> None:
        self._set_array("bits", bool, (None,))


@record
class Everything(FileRecord):
    """A record with a field of every kind."""

    FORMAT = "eldir-everything/2"
    OLDER = ("eldir-everything/1",)

    count: Annotated[int, Field(ge=0, le=2**62)]
    """A whole number."""
    size: Annotated[float, Field(gt=0, le=1e6)]
    """A size [m]."""
    kind: Literal["near", "far"]
    """A word."""
    right: bool
    """A truth."""
    pair: tuple[int, float]
    """Two numbers."""
    curve: Annotated[FloatArray, Array("f8", None, 2)]
    """Points [m], shape (N, 2)."""
    track: Annotated[FloatArray, Array("f8", None, gaps=True)]
    """Places with gaps [m], shape (T,)."""
    numbers: Annotated[IntArray, Array("i4", 3)]
    """Three whole numbers."""
    mask: Mask
    """A mask."""
    main: Supply = field(default_factory=Supply)
    """The main supply."""
    others: tuple[Supply, ...] = ()
    """Other supplies."""
    named: dict[str, Supply] = field(default_factory=dict)
    """Supplies by name."""
    spare: Annotated[Supply | None, OMITTED] = None
    """A spare one."""
    note: str | None = None
    """A note."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Anything plain."""

    def __post_init__(self) -> None:
        if self.spare is not None and self.spare.volts > 2 * self.main.volts:
            raise ValueError("the spare supply has more than twice the voltage")
        if self.main.name == "refused":
            raise InputError("the main supply is refused")

    @classmethod
    def upgrade(cls, values: dict[str, Any]) -> dict[str, Any]:
        values = super().upgrade(values)
        return values if "kind" in values else values | {"kind": values["former_kind"][::-1]} | NOTHING


NOTHING: dict[str, Any] = {}
SUPPLIES = st.builds(Supply, st.floats(1.0, 2.0), st.text(st.characters(codec="utf-8"), max_size=5))
EVERYTHING = st.builds(
    Everything,
    st.integers(0, 2**62),
    st.floats(1e-300, 1e6),  # compiled code may have made this process take smaller ones for 0
    st.sampled_from(["near", "far"]),
    st.booleans(),
    st.tuples(st.integers(-(2**62), 2**62), FINITE),
    arrays(float, st.tuples(st.integers(0, 4), st.just(2)), elements=FINITE),
    arrays(float, st.integers(0, 4), elements=FINITE | st.just(np.nan)),
    arrays(np.int32, 3),
    st.builds(Mask, arrays(bool, st.integers(0, 4))),
    SUPPLIES,
    st.lists(SUPPLIES, max_size=2).map(tuple),
    st.dictionaries(st.sampled_from("abc"), SUPPLIES, max_size=2),
    st.none() | SUPPLIES,
    st.none() | st.text(st.characters(codec="utf-8"), max_size=5),
    st.dictionaries(st.sampled_from("xyz"), st.none() | st.booleans() | FINITE | st.lists(st.integers(0, 9))),
)
ONE = Everything.from_json(
    {
        **{"count": 3, "size": 2, "kind": "far", "right": True, "pair": [1, 2.5], "curve": [[0, 1]]},
        **{"track": [1.0, None], "numbers": [1, 2, 3], "mask": {"bits": [True, False]}},
    }
)
SCHEMA = adapter(Everything).json_schema()
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def changed(**changes: Any) -> Everything:
    return replace(ONE, **changes)


@settings(max_examples=25, deadline=None)
@given(EVERYTHING)
def test_a_record_survives_its_file(made: Everything) -> None:
    text = json.dumps(made.to_json(), allow_nan=False)
    again = Everything.from_json(json.loads(text))
    assert again == made
    assert json.dumps(again.to_json()) == text
    VALIDATOR.validate(json.loads(text))


def test_a_file_has_the_entries_in_the_order_of_the_fields(tmp_path: Path) -> None:
    ONE.save(tmp_path / "a.json")
    text = (tmp_path / "a.json").read_text()
    values = json.loads(text)
    assert list(values)[:4] == ["format", "count", "size", "kind"]
    assert values["main"] == {"voltage_v": 11.0, "name": "bench"}, "an alias is the name in files"
    assert values["track"] == [1.0, None] and values["note"] is None and "spare" not in values
    assert Everything.load(tmp_path / "a.json") == ONE
    Everything.load(tmp_path / "a.json").save(tmp_path / "b.json")
    assert (tmp_path / "b.json").read_text() == text


WRONG: dict[str, tuple[str, Any, str]] = {
    "a string as a number": ("size", "2.0", "size"),
    "true as a number": ("size", True, "size"),
    "true as a whole number": ("count", True, "count"),
    "a fraction as a whole number": ("count", 1.5, "count"),
    "out of range": ("size", 0.0, "size"),
    "too large": ("size", 2e6, "size"),
    "an unknown word": ("kind", "middle", "kind"),
    "a number as a truth": ("right", 1, "right"),
    "null": ("count", None, "count"),
    "too short": ("pair", [1], "pair"),
    "wrong shape": ("curve", [[1.0, 2.0, 3.0]], "curve"),
    "ragged": ("curve", [[1.0, 2.0], [3.0]], "curve"),
    "a string in an array": ("curve", [[1.0, "2.0"]], "curve"),
    "true in an array": ("curve", [[1.0, True]], "curve"),
    "null in an array": ("curve", [[1.0, None]], "curve"),
    "a string beside a gap": ("track", [None, "1.0"], "track"),
    "true beside a gap": ("track", [None, True], "track"),
    "a fraction in an array": ("numbers", [1, 2, 2.5], "numbers"),
    "too large an integer": ("numbers", [1, 2, 2**31], "numbers"),
    "too small an integer": ("numbers", [1, 2, -(2**31) - 1], "numbers"),
    "a wrong length": ("numbers", [1, 2], "numbers"),
    "numbers as bits": ("mask", {"bits": [1, 0]}, "mask.bits"),
    "a list as entries": ("main", [1], "main"),
    "an inner value": ("others", [{"voltage_v": 1.0}, {"voltage_v": -1.0}], "others.1.voltage_v"),
    "a value under a name": ("named", {"a": {"voltage_v": -1.0}}, "named.a.voltage_v"),
    "an inner name": ("main", {"voltage_v": 1.0, "amperes": 2}, "main.amperes"),
    "the name in memory": ("main", {"voltage_v": 1.0, "volts": 1.0}, "main.volts"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_value_in_a_file_is_named_with_its_place(case: str, tmp_path: Path) -> None:
    entry, value, place = WRONG[case]
    values = ONE.to_json() | {entry: value}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(values))
    with pytest.raises(InputError) as caught:
        Everything.load(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: ") and place in said and "\n" not in said
    with pytest.raises(jsonschema.ValidationError):
        VALIDATOR.validate(values)


@pytest.mark.parametrize(
    "case", [name for name in WRONG if WRONG[name][0] not in ("main", "others", "named", "mask")]
)
def test_a_wrong_value_is_refused_at_construction(case: str) -> None:
    entry, value, _ = WRONG[case]
    for _ in range(2):  # pydantic makes the constructor anew when a class is first used
        with pytest.raises(InputError, match=rf"^(invalid )?Everything\.{entry}"):
            changed(**{entry: tuple(value) if entry == "pair" else value})


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_a_number_that_a_file_cannot_have_is_refused(wrong: float) -> None:
    for changes in (
        {"size": wrong},
        {"curve": [[wrong, 0.0]]},
        {"pair": (1, wrong)},
        {"curve": [[10**400, 0]]},
    ):
        with pytest.raises(InputError):
            changed(**changes)
    with pytest.raises(ValueError, match="JSON"):
        json.dumps(changed(provenance={"x": wrong}).to_json(), allow_nan=False)


def test_what_is_given_by_position_is_named() -> None:
    for _ in range(2):
        with pytest.raises(InputError, match=r"^invalid Supply\.volts.*greater than 0.*found -1"):
            Supply(-1.0)
        with pytest.raises(InputError, match=r"^too many arguments for Supply"):
            Supply(1.0, "a", "b")  # type: ignore[call-arg]
        with pytest.raises(InputError, match=r"^Supply: unknown entry amperes"):
            Supply(amperes=1.0)  # type: ignore[call-arg]
    with pytest.raises(InputError, match=r"^Everything\.size is missing"):
        Everything(1)  # type: ignore[call-arg]


def test_numbers_of_numpy_are_as_good() -> None:
    made = changed(count=np.int64(3), size=np.float32(2.0), right=np.bool_(True))
    assert made == ONE
    assert [type(v) for v in (made.count, made.size, made.right)] == [int, float, bool]
    assert json.dumps(made.to_json()) == json.dumps(ONE.to_json())


def test_whole_numbers_become_fractions_where_these_are_meant() -> None:
    assert json.dumps(Supply(11).to_json()) == '{"voltage_v": 11.0, "name": "bench"}'


def test_arrays_are_read_only_and_apart_from_what_was_given() -> None:
    own = np.zeros((2, 2))
    made = changed(curve=own)
    own[:] = 1.0
    assert not made.curve.any()
    with pytest.raises(ValueError, match="read-only"):
        made.curve[0, 0] = 1.0
    assert changed(curve=[]).curve.shape == (0, 2)
    assert changed(numbers=np.array([1.0, 2.0, 3.0])).numbers.dtype == np.int32
    for wrong in (np.array([1, 2, 2**40]), [1, 2, 2**100], [1, 2, np.inf], [1, 2, 1e300]):
        with pytest.raises(InputError, match=r"Everything\.numbers"):
            changed(numbers=wrong)


def test_a_missing_entry_is_named(tmp_path: Path) -> None:
    for entry in ("count", "kind", "mask"):
        values = ONE.to_json()
        del values[entry]
        with pytest.raises(InputError, match=entry):
            Everything.from_json(values)
    assert (
        Everything.from_json({k: v for k, v in ONE.to_json().items() if k not in ("main", "others", "note")})
        == ONE
    )
    assert Supply() == Supply.from_json({"voltage_v": 11.0})
    with pytest.raises(InputError, match="voltage_v is missing"):
        Supply.from_json({"name": "bench"})  # not the default: a file says what it means
    with pytest.raises(InputError, match="voltage_v is missing"):
        Everything.from_json(ONE.to_json() | {"others": [{"name": "x"}]})
    assert SCHEMA["$defs"]["Supply"]["required"] == ["voltage_v"]


def test_older_files_are_read_at_every_depth(tmp_path: Path) -> None:
    old = {"u": 5.0, "name": "old"}
    values: dict[str, Any] = ONE.to_json() | {"format": "eldir-everything/1", "former_kind": "raf"}
    del values["kind"]
    values |= {"main": old, "others": [old], "named": {"x": old}, "spare": old}
    new = Supply(5.0, "old")
    with pytest.raises(InputError, match="former_kind"):  # which this upgrade leaves
        Everything.from_json(values)
    NOTHING.clear()
    path = tmp_path / "a.json"
    del values["former_kind"]
    path.write_text(json.dumps(values | {"kind": "far"}))
    assert Everything.load(path) == changed(main=new, others=(new,), named={"x": new}, spare=new)
    path.write_text(json.dumps(values))
    with pytest.raises(InputError, match=r"a\.json: former_kind is missing"):
        Everything.load(path)
    path.write_text(json.dumps(values | {"format": "eldir-everything/3"}))
    with pytest.raises(InputError, match=r"^invalid format of"):
        Everything.load(path)


def test_values_that_do_not_fit_each_other(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^Everything: the spare supply has more"):
        changed(spare=Supply(30.0))
    path = tmp_path / "a.json"
    path.write_text(json.dumps(ONE.to_json() | {"spare": Supply(30.0).to_json()}))
    with pytest.raises(InputError, match=r"a\.json: the spare supply has more"):
        Everything.load(path)
    path.write_text(json.dumps(ONE.to_json() | {"main": Supply(1.0, "refused").to_json()}))
    with pytest.raises(InputError, match=r"a\.json is invalid: the main supply is refused"):
        Everything.load(path)


def test_records_are_equal_where_every_field_is() -> None:
    assert ONE == changed() != changed(track=[1.0, 2.0])
    assert changed(main=Supply(2.0)) != ONE != 3
    assert len({Supply(), Supply(11), Supply(2.0)}) == 2
    with pytest.raises(TypeError, match="unhashable"):
        hash(ONE)


def test_a_field_that_is_added_is_in_schema_file_and_error_at_once() -> None:
    @record
    class More(Supply):
        """A supply of which more is known."""

        OPTIONAL = frozenset({"name"})

        amperes: Annotated[float, Field(ge=0, le=40)] = 4.0
        """Current limit [A]."""

    schema = adapter(More).json_schema()
    entry = schema["properties"]["amperes"]
    assert (entry["description"], entry["maximum"], entry["minimum"]) == ("Current limit [A].", 40, 0)
    assert schema["properties"]["voltage_v"]["description"] == "Voltage [V]."
    assert schema["required"] == ["voltage_v", "amperes"] and schema["description"].startswith("A supply of")
    assert More(1.0).to_json() == {"voltage_v": 1.0, "name": "bench", "amperes": 4.0}
    with pytest.raises(InputError, match=r"file: invalid amperes.*40.*found 41"):
        validate(More, {"voltage_v": 1.0, "amperes": 41}, "file")
    with pytest.raises(InputError, match="file: amperes is missing"):
        validate(More, {"voltage_v": 1.0}, "file")
