"""Whether numbers are plausible in the unit they should have, and in which unit they would be."""

from __future__ import annotations

from dataclasses import dataclass

from eldir.errors import InputError


@dataclass(frozen=True)
class Unit:
    """Another unit of a quantity: a number x in it is `scale * x + offset` in the expected one."""

    name: str
    scale: float
    offset: float = 0.0


@dataclass(frozen=True)
class Quantity:
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


def length(unit: str, low: float, high: float) -> Quantity:
    """A length in "m" or "mm" with its plausible range."""
    names = {"metres": 1.0, "millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
    expected = {"m": 1.0, "mm": 1e-3}[unit]
    others = tuple(Unit(name, metres / expected) for name, metres in names.items() if metres != expected)
    return Quantity(unit, low, high, others)
