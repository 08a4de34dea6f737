"""Dual numbers in code that is being compiled: a value, and its derivative with respect to the lane's
parameter (forward-mode differentiation).

An element function is written once, for plain vectors and for dual numbers. The functions below take both, as
the operators + - * / do, and comparisons compare values. Without tangents no dual number is made, and the
compiled code has no trace of this module.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from eldir.engine.built.motion_launch import ZERO, LaneVector
from eldir.engine.compiler import NAME, Expr, expr_init, subscript, ti
from eldir.engine.kernels.memory import local

Function = TypeVar("Function", bound=Callable[..., Any])


class _NoExpression:
    def set_dbg_info(self, position: Any) -> None:
        """The compilers tell each expression where it stands in the source."""


class Dual(Expr):  # type: ignore[misc]
    """A value and its derivative.

    It is an `Expr`, so that Python asks it first when it stands to the right of one. Its `ptr` is no
    expression: where a function of the compiler gets a dual number, compiling fails instead of losing the
    derivative.
    """

    _data_oriented = True  # the compilers assign such an object to a name as it is
    ptr, dbg_info = _NoExpression(), None

    def __init__(self, value: Any, derivative: Any):
        self.value, self.derivative = local(value), local(derivative)

    def __add__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.derivative + other.derivative)
        return Dual(self.value + other, self.derivative)

    def __radd__(self, other: Any) -> Dual:
        return Dual(other + self.value, self.derivative)

    def __sub__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value - other.value, self.derivative - other.derivative)
        return Dual(self.value - other, self.derivative)

    def __rsub__(self, other: Any) -> Dual:
        return Dual(other - self.value, ZERO - self.derivative)

    def __mul__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(
                self.value * other.value, self.derivative * other.value + self.value * other.derivative
            )
        return Dual(self.value * other, self.derivative * other)

    def __rmul__(self, other: Any) -> Dual:
        return Dual(other * self.value, other * self.derivative)

    def __truediv__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            quotient = local(self.value / other.value)
            return Dual(quotient, (self.derivative - quotient * other.derivative) / other.value)
        return Dual(self.value / other, self.derivative / other)

    def __rtruediv__(self, other: Any) -> Dual:
        quotient = local(other / self.value)
        return Dual(quotient, ZERO - quotient * self.derivative / self.value)

    def __lt__(self, other: Any) -> Any:
        return self.value < value_of(other)

    def __gt__(self, other: Any) -> Any:
        return self.value > value_of(other)


class Variable(Dual):
    """A dual number to which compiled code assigns."""

    def __init__(self, value: Any, derivative: Any):
        self.value, self.derivative = expr_init(value), expr_init(derivative)

    def _assign(self, other: Any) -> None:
        self.value._assign(value_of(other))
        self.derivative._assign(derivative_of(other))

    def _augassign(self, other: Any, operator: str) -> None:
        assert operator == "Add", operator  # of a difference the compilers make an operation on integers
        self._assign(self + other)


class Element(Dual):
    """An element of two arrays, read at this point of the code; assigning to it writes to both."""

    def __init__(self, value: Any, derivative: Any):
        super().__init__(expr_init(value), expr_init(derivative))
        self._places = value, derivative

    def _assign(self, other: Any) -> None:
        value, derivative = self._places
        value._assign(value_of(other))
        derivative._assign(derivative_of(other))


class DualView:
    """An array of values and the array of their derivatives."""

    def __init__(self, values: Any, derivatives: Any):
        self.values, self.derivatives = values, derivatives

    def __getitem__(self, i: Any) -> Element:
        return Element(*(subscript(None, array, i) for array in (self.values, self.derivatives)))


def pair(value: Any, derivative: Any) -> Any:
    """A number, an array or a tuple of these, with its derivative."""
    if isinstance(value, tuple):
        return type(value)(*map(pair, value, derivative))
    return (Dual if isinstance(value, Expr) else DualView)(value, derivative)


def callable_in_kernels(function: Function) -> Function:
    """Without this mark the compilers warn that a function is not theirs; False says so."""
    setattr(function, f"_is_{NAME}_function", False)
    return function


@callable_in_kernels
def value_of(x: Any) -> Any:
    return x.value if isinstance(x, Dual) else x


@callable_in_kernels
def derivative_of(x: Any) -> Any:
    return x.derivative if isinstance(x, Dual) else ZERO


@callable_in_kernels
def variable(x: Any) -> Any:
    """A number to which later code may assign."""
    return Variable(x.value, x.derivative) if isinstance(x, Dual) else x


@callable_in_kernels
def negative(x: Any) -> Any:
    """-x, of which the compilers make an operation on integers."""
    return Dual(ZERO - x.value, ZERO - x.derivative) if isinstance(x, Dual) else ZERO - x


@callable_in_kernels
def sqrt(x: Any) -> Any:
    if not isinstance(x, Dual):
        return ti.sqrt(x)
    root = local(ti.sqrt(x.value))
    return Dual(root, 0.5 * x.derivative / root)


@callable_in_kernels
def select(condition: Any, a: Any, b: Any) -> Any:
    if not (isinstance(a, Dual) or isinstance(b, Dual)):
        return ti.select(condition, a, b)
    return Dual(
        ti.select(condition, value_of(a), value_of(b)),
        ti.select(condition, derivative_of(a), derivative_of(b)),
    )


@callable_in_kernels
def maximum(a: Any, b: Any) -> Any:
    """Of equal numbers, the derivative of the second counts."""
    if not (isinstance(a, Dual) or isinstance(b, Dual)):
        return ti.max(a, b)
    larger = local(value_of(a) > value_of(b))
    derivative = ti.select(larger, derivative_of(a), derivative_of(b))
    return Dual(ti.max(value_of(a), value_of(b)), derivative)


@callable_in_kernels
def minimum(a: Any, b: Any) -> Any:
    """Of equal numbers, the derivative of the second counts."""
    if not (isinstance(a, Dual) or isinstance(b, Dual)):
        return ti.min(a, b)
    smaller = local(value_of(a) < value_of(b))
    derivative = ti.select(smaller, derivative_of(a), derivative_of(b))
    return Dual(ti.min(value_of(a), value_of(b)), derivative)


@callable_in_kernels
def zero_like(x: Any) -> Any:
    """0, to which later code may assign."""
    zero = LaneVector(0.0)
    return Variable(zero, zero) if isinstance(x, Dual) else zero


@callable_in_kernels
def polynomial(x: Any, coefficients: Sequence[float]) -> Any:
    """From the constant term on."""
    found = LaneVector(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        found = local(x * found + LaneVector(coefficient))
    return found
