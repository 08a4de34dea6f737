"""Records: immutable dataclasses that say the type, range, unit and meaning of a field once, in the field.

A field is checked by its annotation when a record is made and when it is read from a file; JSON Schemas and
reference pages are made from the same annotations (`docs/site/schemas.py`, `docs/site/format_pages.py`).
"""

from __future__ import annotations

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar, cast, dataclass_transform

import numpy as np
import pydantic
from numpy.typing import DTypeLike, NDArray
from pydantic import ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from eldir.core.arguments import describe_mismatch
from eldir.core.files import MAX_JSON_BYTES, read_json, write_text
from eldir.core.validation import STRICT, Checked, Plain, validate
from eldir.errors import InputError

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.integer]
BoolArray = NDArray[np.bool_]

OMITTED = Field(exclude_if=lambda value: value is None)
"""Annotation of a field that a file leaves out where it is None."""

SourceDigest = Annotated[str, Field(pattern="^[0-9a-f]{12}$")]
"""What `eldir.core.version.source_digest` gives."""

_Class = TypeVar("_Class", bound=type)


@dataclass_transform(frozen_default=True, eq_default=False)
def record(cls: _Class) -> _Class:
    """Make a class of annotated fields, derived from `Record`, a frozen dataclass that checks its fields.

    Raises `InputError` where it is constructed with an invalid value.
    """
    config = ConfigDict(**STRICT, defer_build=True)
    return cast(_Class, pydantic.dataclasses.dataclass(cls, frozen=True, eq=False, config=config))


class Record(Plain, metaclass=Checked):
    """Base of the records: equal when every field is, and in the order of the first that differs."""

    @classmethod
    def construct(cls, *values: Any) -> Self:
        """A record of values that need no check, for many that are computed at once: arrays have the types of
        their fields, belong to this record alone or are never written, and become read-only."""
        made = object.__new__(cls)
        made.__dict__.update(zip(cls.__dataclass_fields__, values, strict=True))  # type: ignore[attr-defined]
        for value in values:
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        return made

    def _set_array(self, name: str, dtype: DTypeLike, shape: tuple[int | None, ...]) -> None:
        """Store field `name` as a read-only array; `None` in `shape` admits any length."""
        given = getattr(self, name)
        try:
            array = Array(dtype, *shape, gaps=True).read(np.asarray(given, dtype) if dtype is bool else given)
        except ValueError as error:
            place = f"{type(self).__name__}.{name}"
            code = "input.wrong-shape" if isinstance(error, _ShapeError) else "input.wrong-value"
            raise InputError(f"{place}: {error}", code=code, key=place) from None
        object.__setattr__(self, name, array)

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_same(getattr(self, f.name), getattr(other, f.name)) for f in fields(self))  # type: ignore[arg-type]

    def __hash__(self) -> int:
        return hash(self._values)

    def __lt__(self, other: Self) -> bool:
        return self._values < other._values

    @property
    def _values(self) -> tuple[Any, ...]:
        return tuple(getattr(self, f.name) for f in fields(self))  # type: ignore[arg-type]


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    return bool(a == b)


class FileRecord(Record):
    """Base of the records that are a whole JSON file each, of which "format" names format and version."""

    FORMAT: ClassVar[str]
    OLDER: ClassVar[tuple[str, ...]] = ()
    """Former formats, which `upgrade` takes too."""
    MAX_BYTES: ClassVar[int] = MAX_JSON_BYTES
    INDENT: ClassVar[int | None] = 1
    """Of the lines of the file; None: all in one line."""

    def to_json(self) -> dict[str, Any]:
        """Plain values as in the file."""
        return {"format": self.FORMAT} | super().to_json()

    @classmethod
    def upgrade(cls, values: dict[str, Any]) -> dict[str, Any]:
        """The values without their format, and those of an older file as this version has them."""
        return {key: value for key, value in values.items() if key != "format"}

    def to_text(self) -> str:
        """The file; the same record gives the same bytes."""
        return json.dumps(self.to_json(), indent=self.INDENT, allow_nan=False) + "\n"

    def save(self, path: Path | str) -> None:
        """Write the file."""
        write_text(Path(path), self.to_text())

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a file. Raises `InputError` for a missing, damaged or foreign one."""
        known = (cls.FORMAT, *cls.OLDER)
        return validate(cls, read_json(Path(path), cls.FORMAT, known, cls.MAX_BYTES), str(path))

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = super().__get_pydantic_json_schema__(core, handler)
        resolved = handler.resolve_ref_schema(schema)
        meaning = "Format of this file: its name and the number of its version."
        entry = {"const": cls.FORMAT, "description": meaning}
        resolved["properties"] = {"format": entry} | resolved["properties"]
        resolved["required"] = ["format", *resolved.get("required", [])]
        return schema


class _ShapeError(ValueError):
    """An array has another shape."""


class Array:
    """Annotation of an array of finite numbers: its type and shape, in which None admits any length.

    It is stored read-only; a file has it as nested lists. With `gaps` it may hold NaN, which is `null` there.
    """

    def __init__(self, dtype: DTypeLike, *shape: int | None, gaps: bool = False):
        self.dtype, self.shape, self.gaps = np.dtype(dtype), shape, gaps

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            self.read,
            serialization=core_schema.plain_serializer_function_ser_schema(self._lists, when_used="json"),
        )

    def __get_pydantic_json_schema__(self, core: CoreSchema, _: GetJsonSchemaHandler) -> JsonSchemaValue:
        kind = {"f": "number", "i": "integer", "u": "integer", "b": "boolean"}[self.dtype.kind]
        schema: JsonSchemaValue = {"type": [kind, "null"] if self.gaps else kind}
        if kind == "integer" and self.dtype.itemsize < 8:
            known = np.iinfo(self.dtype)
            schema |= {"minimum": int(known.min), "maximum": int(known.max)}
        for length in reversed(self.shape):
            schema = {"type": "array", "items": schema}
            if length is not None:
                schema |= {"minItems": length, "maxItems": length}
        return schema

    def read(self, given: Any) -> NDArray[Any]:
        """The array; raises `ValueError` for another type or shape."""
        own = isinstance(given, np.ndarray) and given.dtype == self.dtype
        array = np.array(given if own else self._converted(given))
        if self.dtype.kind == "f" and not self.gaps and not np.isfinite(array).all():
            raise ValueError("expected finite numbers")
        if array.size == 0:  # a list without rows has no row length
            array = array.reshape(*array.shape, *(n or 0 for n in self.shape[array.ndim :]))
        if wanted := describe_mismatch(array.shape, self.shape):
            raise _ShapeError(f"invalid shape: expected {wanted}, found {array.shape}")
        array.flags.writeable = False
        return array

    def _converted(self, given: Any) -> NDArray[Any]:
        """What is given as an array of the type."""
        try:
            array = np.asarray(given)
        except ValueError:
            raise ValueError("expected rows of the same length") from None
        if isinstance(given, np.ndarray) and array.dtype != object:
            kinds = {array.dtype.type}
        else:
            kinds = set(map(type, np.asarray(given, dtype=object).ravel().tolist()))
        if not all(map(self._is_taken, kinds)):
            wanted = {"b": "true or false", "f": "numbers"}.get(self.dtype.kind, "whole numbers")
            raise ValueError(f"expected {wanted}")
        if self.dtype.kind in "iu":
            known = np.iinfo(self.dtype)
            if (
                array.dtype == object
                or not ((array == np.rint(array)) & (known.min <= array) & (array <= known.max)).all()
            ):
                raise ValueError(f"expected whole numbers from {known.min} to {known.max}")
        try:
            return array.astype(self.dtype)
        except OverflowError:
            raise ValueError("expected finite numbers") from None

    def _is_taken(self, kind: type) -> bool:
        """Whether a value may be of this type; `true` is not accepted as a number."""
        if kind is type(None):
            return self.gaps
        if self.dtype.kind == "b":
            return issubclass(kind, bool | np.bool_)
        return issubclass(kind, int | float | np.number) and kind is not bool

    def _lists(self, array: NDArray[Any]) -> Any:
        if not self.gaps or (known := np.isfinite(array)).all():
            return array.tolist()
        given: NDArray[Any] = array.astype(object)
        given[~known] = None
        return given.tolist()


class Rounded:
    """Annotation of a number that a file has with so many decimals, and as `null` where it is not finite."""

    def __init__(self, decimals: int, ge: float = -math.inf, le: float = math.inf):
        self.decimals, self.ge, self.le = decimals, ge, le

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            self._number,
            serialization=core_schema.plain_serializer_function_ser_schema(self._rounded, when_used="json"),
        )

    def __get_pydantic_json_schema__(self, core: CoreSchema, _: GetJsonSchemaHandler) -> JsonSchemaValue:
        limits = {"minimum": self.ge, "maximum": self.le}
        return {"type": ["number", "null"]} | {k: v for k, v in limits.items() if math.isfinite(v)}

    def _number(self, given: Any) -> float:
        if given is None:
            return math.nan
        if isinstance(given, bool) or not isinstance(given, int | float | np.integer | np.floating):
            raise ValueError("expected a number")
        value = float(given)
        rounded = self._rounded(value)
        if rounded is not None and not self.ge <= rounded <= self.le:
            raise ValueError(f"expected a number from {self.ge:g} to {self.le:g}, found {rounded:g}")
        return value

    def _rounded(self, value: float) -> float | None:
        return round(value, self.decimals) if math.isfinite(value) else None
