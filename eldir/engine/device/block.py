"""Blocks of threads: what they share, and phases between barriers.

A phase is what every thread does between two barriers. On a device the threads run it at once and then wait
for each other. On the CPU the same source is a loop over the threads, ascending or descending, and shared
memory is a part of an array: where the two orders disagree, a barrier is missing.
"""

from typing import Any, NamedTuple

from eldir.engine.compiler import subscript, ti

DEVICE, ASCENDING, DESCENDING = 0, 1, -1
"""Order of the threads: all at once, or one after the other."""


class Values(NamedTuple):
    """`values[i]` and `values.each[i]` are element `first + i` of an array."""

    array: Any
    first: Any

    def __getitem__(self, i: Any) -> Any:
        return subscript(None, self.array, self.first + i)

    @property
    def each(self) -> "Values":
        return self

    def __add__(self, count: Any) -> "Values":  # type: ignore[override]
        return Values(self.array, self.first + count)


class SharedMemory:
    """Arrays of one robot that its threads share.

    On a device they lie in shared memory, beside those of the other robots of the block; `index` is the
    robot's number among them. On the CPU they lie one after the other in `array`, and `index` counts all
    robots. `used` counts a robot's values."""

    def __init__(self, real: Any, order: int, robots: int, array: Any, index: Any, room: int):
        self._real, self._order, self._robots = real, order, robots
        self._array, self._index, self._room = array, index, room
        self.used = 0

    def take(self, count: int) -> Values:
        first, self.used = self.used, self.used + count
        if self._order == DEVICE and self._real is not None:
            shared = ti.simt.block.SharedArray((self._robots * count,), self._real)
            return Values(shared, self._index * count)
        return Values(self._array, self._index * self._room + first)


def phase_of(order: int, threads: int) -> Any:
    """The function `phase(work, own, block)`: every thread of a block does `work(thread, block)`, and waits
    for the others. `own` is the number of the thread that calls it; on the CPU, one calls it for all."""

    @ti.func
    def phase(work: ti.template(), own, block: ti.template()):
        if ti.static(order == DEVICE):
            work(own, block)
            ti.simt.block.sync()
        else:
            for thread in range(threads):
                work(thread if ti.static(order == ASCENDING) else threads - 1 - thread, block)

    return phase
