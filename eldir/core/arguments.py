"""Checks of arguments. Each kind of fault has one message and one code, and `key` names the argument.

A number beyond the limits of a run is refused before anything is allocated or written.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Integral

from eldir.errors import InputError

_MAX_GENES = 100_000_000
"""Triangles of a generation: about a gigabyte while they are sampled."""
_MAX_LOSSES = 100_000_000


def require_value(
    name: str, ok: object, expected: str, found: object = None, remedy: str | None = None
) -> None:
    """Raise `InputError` unless `ok`, the check of the argument of this name, is true."""
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


def require_count(what: str, found: int, wanted: int, each: str = "robot") -> None:
    """Raise `InputError` unless there are as many as wanted, one for each robot, or whatever `each` says."""
    if found != wanted:
        expected = f"{wanted}, one for each {each}"
        problem = f"invalid number of {what}"
        raise InputError(problem, code="input.wrong-number", key=what, expected=expected, found=str(found))


def require_shape(
    name: str, shape: tuple[int, ...], *wanted: tuple[int | None, ...], remedy: str | None = None
) -> None:
    """Raise `InputError` unless an array has one of the wanted shapes, in which `None` admits any length."""
    if expected := describe_mismatch(shape, *wanted):
        problem, code = f"invalid shape of {name}", "input.wrong-shape"
        raise InputError(problem, code=code, key=name, expected=expected, found=str(shape), remedy=remedy)


def describe_mismatch(shape: tuple[int, ...], *wanted: tuple[int | None, ...]) -> str:
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


def require_whole_number(name: str, value: object, least: int, most: int | None = None) -> int:
    """The value as an int; NumPy's integers are welcome. Raises `InputError` unless it is in the range."""
    number = int(value) if isinstance(value, Integral) else least - 1
    upper = f"of at least {least}" if most is None else f"from {least} to {most}"
    fits = least <= number and (most is None or number <= most)
    require_value(name, fits, f"a whole number {upper}", f"{value}"[:40])
    return number


def require_memory(rows: int, columns: int, population: int, iterations: int = 0) -> None:
    """Raise `InputError` if the genes or the losses of one generation do not fit into memory."""
    for what, found, most in (
        ("population x rows x columns", population * rows * columns, _MAX_GENES),
        ("population x iterations", population * (iterations + 1), _MAX_LOSSES),
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


@dataclass(frozen=True)
class Unit:
    """Another unit of a quantity: a number x in it is `scale * x + offset` in the expected one."""

    name: str
    scale: float
    offset: float = 0.0


@dataclass(frozen=True)
class PlausibleRange:
    """A quantity of which people give numbers in several units."""

    unit: str
    """The expected unit, as it is printed."""
    low: float
    high: float
    """Range of plausible numbers in the expected unit."""
    others: tuple[Unit, ...]
    """Units in which people give it by mistake."""

    def require_plausible(self, what: str, value: float, remedy: str = "convert it") -> None:
        """Raise `InputError` where `value` is outside of the range, with the units in which it is inside."""
        if self.low <= value <= self.high:
            return
        units = [u.name for u in self.others if self.low <= u.scale * value + u.offset <= self.high]
        raise InputError(
            f"{what} is not plausible",
            code="input.implausible",
            expected=f"{self.low:g} to {self.high:g} {self.unit}",
            found=f"{value:.6g}" + (f", which looks like {' or '.join(units)}" if units else ""),
            remedy=remedy,
        )


def length_quantity(unit: str, low: float, high: float) -> PlausibleRange:
    """A length in "m" or "mm" with its plausible range."""
    names = {"metres": 1.0, "millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
    expected = {"m": 1.0, "mm": 1e-3}[unit]
    others = tuple(Unit(name, metres / expected) for name, metres in names.items() if metres != expected)
    return PlausibleRange(unit, low, high, others)
