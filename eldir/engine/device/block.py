"""A block of threads: what they share, and phases between barriers.

A phase is what every thread does between two barriers. On a device the threads run it at once and then wait
for each other. On the CPU the same source is a loop over the threads, ascending or descending as the launch
says, and shared memory is a part of an array: where the two orders disagree, a barrier is missing.
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
    """Arrays that the threads of a block share: in the device's shared memory or, on the CPU, one after the
    other in `array` from `first` on. `used` counts their values. Without a type `real` it only counts."""

    def __init__(self, real: Any = None, on_device: bool = True, array: Any = None, first: Any = 0):
        self._real, self._on_device = real, on_device
        self._array, self._first = array, first
        self.used = 0

    def take(self, count: int) -> Values:
        first, self.used = self.used, self.used + count
        if self._on_device and self._real is not None:
            return Values(ti.simt.block.SharedArray((count,), self._real), 0)
        return Values(self._array, self._first + first)


def phase_of(on_device: bool, threads: int) -> Any:
    """The function `phase(work, own, block)`: every thread of a block does `work(thread, block)`, and waits
    for the others. `own` is the number of the thread that calls it; on the CPU, one calls it for all."""

    @ti.func
    def phase(work: ti.template(), own, block: ti.template()):
        if ti.static(on_device):
            work(own, block)
            ti.simt.block.sync()
        else:
            for k in range(threads):
                work(k if block.launch.order == ASCENDING else threads - 1 - k, block)

    return phase
