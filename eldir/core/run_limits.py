"""The ranges of a run's numbers. A number beyond them is refused before anything is allocated or written."""

from __future__ import annotations

import math
from numbers import Integral

from eldir.errors import InputError

_GENES = 100_000_000
"""Most triangles in a generation: about a gigabyte while they are drawn."""
_LOSSES = 100_000_000


def require_whole_number(name: str, value: object, least: int, most: int | None) -> None:
    """Raise `InputError` unless the value is a whole number in the range."""
    if isinstance(value, int) and least <= value and (most is None or value <= most):
        return
    expected = (
        f"a whole number of at least {least}" if most is None else f"a whole number from {least} to {most}"
    )
    raise InputError(f"{name} is wrong", expected=expected, found=f"{value}"[:40])


def whole_number(name: str, value: object, least: int, most: int | None = None) -> int:
    """The value as an int; NumPy's integers are welcome. Raises `InputError` unless it is in the range."""
    number = int(value) if isinstance(value, Integral) else value
    require_whole_number(name, number, least, most)
    assert isinstance(number, int)
    return number


def require_room(rows: int, columns: int, population: int, iterations: int = 0) -> None:
    """Raise `InputError` if the genes or the losses of one generation do not fit into memory."""
    for what, found, most in (
        ("population x rows x columns", population * rows * columns, _GENES),
        ("population x iterations", population * (iterations + 1), _LOSSES),
    ):
        if found > most:
            raise InputError(
                "a generation would be too large for the memory",
                expected=f"{what} of at most {most}",
                found=str(found),
                remedy="use a smaller population or lattice",
            )


def require_margin(name: str, margin: float, columns: int, pitch: float) -> None:
    """Raise `InputError` for a static margin [m] that no body on the lattice can have.

    The vertices span at most `columns` + 1 half pitches [m], and the centre of mass is at most half of that
    from the edge of the feet.
    """
    most = pitch * (columns + 1) / 4
    if not -math.inf < margin <= most:
        raise InputError(
            f"{name} is wrong",
            expected=f"at most {1e3 * most:.0f} mm on a lattice of {columns} columns",
            found=f"{1e3 * margin:g} mm",
        )
