"""Checks of arguments: every kind of fault has one sentence and one code, and its `key` names the argument.

A number beyond the ranges of a run is refused before anything is allocated or written.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Integral

from eldir.errors import InputError

_GENES = 100_000_000
"""Most triangles in a generation: about a gigabyte while they are drawn."""
_LOSSES = 100_000_000


def require_value(
    name: str, ok: object, expected: str, found: object = None, remedy: str | None = None
) -> None:
    """Raise `InputError` unless the argument of this name is right."""
    if not ok:
        given = None if found is None else str(found)
        raise InputError(
            f"invalid {name}",
            code="input.wrong-value",
            key=name,
            expected=expected,
            found=given,
            remedy=remedy,
        )


def require_number(what: str, found: int, wanted: int, each: str = "robot") -> None:
    """Raise `InputError` unless there are as many as wanted, one for each robot, or whatever `each` says."""
    if found != wanted:
        expected = f"{wanted}, one for each {each}"
        problem = f"wrong number of {what}"
        raise InputError(problem, code="input.wrong-number", key=what, expected=expected, found=str(found))


def require_shape(
    name: str, shape: tuple[int, ...], *wanted: tuple[int | None, ...], remedy: str | None = None
) -> None:
    """Raise `InputError` unless an array has one of the wanted shapes, in which `None` admits any length."""
    if expected := unmet(shape, *wanted):
        problem, code = f"{name} has the wrong shape", "input.wrong-shape"
        raise InputError(problem, code=code, key=name, expected=expected, found=str(shape), remedy=remedy)


def unmet(shape: tuple[int, ...], *wanted: tuple[int | None, ...]) -> str:
    """The wanted shapes in words where this is none of them, otherwise nothing."""
    for one in wanted:
        if len(shape) == len(one) and all(w in (None, n) for w, n in zip(one, shape, strict=True)):
            return ""
    return " or ".join(f"({', '.join('any' if n is None else str(n) for n in one)})" for one in wanted)


def require_known(
    what: str, names: str | Iterable[str], known: Iterable[str], remedy: str | None = None
) -> None:
    """Raise `InputError` for a name, or names, of which one is not known."""
    known, names = list(known), [names] if isinstance(names, str) else names
    if unknown := [name for name in names if name not in known]:
        expected, found = " | ".join(known), ", ".join(map(repr, unknown))
        raise InputError(
            f"unknown {what}",
            code="input.unknown-name",
            key=what,
            expected=expected,
            found=found,
            remedy=remedy,
        )


def whole_number(name: str, value: object, least: int, most: int | None = None) -> int:
    """The value as an int; NumPy's integers are welcome. Raises `InputError` unless it is in the range."""
    number = int(value) if isinstance(value, Integral) else least - 1
    upper = f"of at least {least}" if most is None else f"from {least} to {most}"
    fits = least <= number and (most is None or number <= most)
    require_value(name, fits, f"a whole number {upper}", f"{value}"[:40])
    return number


def require_room(rows: int, columns: int, population: int, iterations: int = 0) -> None:
    """Raise `InputError` if the genes or the losses of one generation do not fit into memory."""
    for what, found, most in (
        ("population x rows x columns", population * rows * columns, _GENES),
        ("population x iterations", population * (iterations + 1), _LOSSES),
    ):
        remedy = "use a smaller population or lattice"
        require_value(what, found <= most, f"at most {most}, which fit into the memory", found, remedy)


def require_margin(name: str, margin: float, columns: int, pitch: float) -> None:
    """Raise `InputError` for a static margin [m] that no body on the lattice can have.

    The vertices span at most `columns` + 1 half pitches [m], and the centre of mass is at most half of that
    from the edge of the feet.
    """
    most = pitch * (columns + 1) / 4
    expected = f"at most {1e3 * most:.0f} mm on a lattice of {columns} columns"
    require_value(name, -math.inf < margin <= most, expected, f"{1e3 * margin:g} mm")
