"""Views of one array as vectors of several widths, from an offset that may be known only at run time."""

from __future__ import annotations

from typing import Any, NamedTuple

from eldir.engine.compiler import Expr, expr_init, subscript


class Memory(NamedTuple):
    """One array under six views: single values, vectors of one, pairs, quads, 16 and 32 values at a time."""

    values: Any = None
    ones: Any = None
    pairs: Any = None
    quads: Any = None
    lanes: Any = None
    rows: Any = None


class OffsetView:
    """`view[i]` is `array[first + i]`."""

    def __init__(self, array: Any, first: Any):
        self.array, self.first = array, first

    def __getitem__(self, i: Any) -> Any:
        return subscript(None, self.array, self.first + i)


class UnalignedLanes(OffsetView):
    """`view[k]` are values k to k + 15, at any address, of an array with a view of vectors of one value.

    They are read as if all belonged to the vector at k. So the compilers know that they lie side by side, and
    load them at once. With an index each, which has 32 bits and may overflow, they would be loaded singly.
    """

    def __getitem__(self, k: Any) -> list[Any]:
        vector = super().__getitem__(k)
        return [subscript(None, vector, j) for j in range(16)]


class Column(NamedTuple):
    """A quantity from element `first` of a memory on.

    `column[i]` are its values 16 i to 16 i + 15, `column.each[k]` is value k; `pair`, `quad` and
    `row` go two, four and 32 values at a time; `column + n` begins n values later.
    """

    memory: Memory
    first: Any

    def __getitem__(self, i: Any) -> Any:
        return OffsetView(self.memory.lanes, self.first >> 4)[i]

    @property
    def each(self) -> OffsetView:
        return OffsetView(self.memory.values, self.first)

    @property
    def pair(self) -> OffsetView:
        return OffsetView(self.memory.pairs, self.first >> 1)

    @property
    def quad(self) -> OffsetView:
        return OffsetView(self.memory.quads, self.first >> 2)

    @property
    def row(self) -> OffsetView:
        return OffsetView(self.memory.rows, self.first >> 5)

    @property
    def unaligned(self) -> UnalignedLanes:
        return UnalignedLanes(self.memory.ones, self.first)

    def __add__(self, count: Any) -> Column:
        return Column(self.memory, local(self.first + count))


def local(value: Any) -> Any:
    """The value, computed once at this point of the code; a plain number is returned as it is."""
    return expr_init(value) if isinstance(value, Expr) else value


def load(array: Any, i: Any) -> Any:
    """`array[i]`, read once at this point of the code."""
    return local(subscript(None, array, i))


def reread(array: Any, i: Any) -> Any:
    """`array[i]`, read again wherever it is used: kept in a register, it changes the order in which LLVM adds
    what is multiplied by it, and so the last bit."""
    return subscript(None, array, i)
