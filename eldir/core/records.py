"""Base class of the toolkit's records: immutable fields, arrays checked and compared by value."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from eldir.errors import InputError

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.integer]
BoolArray = NDArray[np.bool_]


class Record:
    """Base of the frozen dataclasses (declared with ``eq=False``): equal when every field is."""

    def _set_array(self, name: str, dtype: DTypeLike, shape: tuple[int | None, ...]) -> None:
        """Store field `name` as a read-only array; `None` in `shape` admits any length."""
        given = getattr(self, name)
        if np.issubdtype(dtype, np.integer):
            self._require_whole(name, np.asarray(given), np.iinfo(dtype).max)
        array = np.array(given, dtype=dtype)
        fits = array.ndim == len(shape) and all(
            want is None or want == have for want, have in zip(shape, array.shape, strict=True)
        )
        if not fits:
            wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
            raise InputError(
                f"{type(self).__name__}.{name} has the wrong shape",
                expected=wanted,
                found=str(array.shape),
            )
        array.flags.writeable = False
        object.__setattr__(self, name, array)

    def _require_whole(self, name: str, given: NDArray[Any], most: int) -> None:
        """Refuse numbers that no integer of the type holds: NumPy makes others of them, with a warning."""
        if given.dtype.kind == "f" and not (np.abs(given) <= most).all():
            raise InputError(
                f"{type(self).__name__}.{name} is wrong", expected=f"whole numbers of at most {most}"
            )

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_same(getattr(self, f.name), getattr(other, f.name)) for f in fields(self))  # type: ignore[arg-type]

    __hash__ = None  # type: ignore[assignment]


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    return bool(a == b)
