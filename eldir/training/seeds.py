"""The seeds of many robots at once, with the numbers of `numpy.random.SeedSequence`.

NumPy makes one sequence in 30 us: a third of a second for a generation of ten thousand robots. Its algorithm
is M. E. O'Neill's seed_seq_fe128, which NumPy keeps as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from eldir.core.records import IntArray

_POOL = 4


def generate_seeds(seed: int, key: int, n: int) -> IntArray:
    """A seed of 63 bits for each of `n` robots, shape (n,): robot i's are the upper bits of
    `SeedSequence(seed, spawn_key=(key, i)).generate_state(1, np.uint64)`."""
    parts = [seed >> shift for shift in range(0, max(seed.bit_length(), 32 * _POOL), 32)]
    common = [np.full(n, part & 0xFFFFFFFF, np.uint32) for part in (*parts, key)]
    low, high = _state([*common, np.arange(n, dtype=np.uint32)], 2)
    return ((high.astype(np.uint64) << 32 | low) >> 1).astype(np.int64)


def _state(entropy: list[IntArray], words: int) -> list[IntArray]:
    """Words of the state of each sequence; its entropy, at least a pool full, are the words at its place."""
    hashes = _hashes(0x43B0D7E5, 0x931E8875)
    pool = [next(hashes)(word) for word in entropy[:_POOL]]

    def mix(i: int, word: IntArray) -> None:
        mixed = np.uint32(0xCA01F9DD) * pool[i] - np.uint32(0x4973F715) * next(hashes)(word)
        pool[i] = mixed ^ mixed >> 16

    for source in range(_POOL):
        for i in range(_POOL):
            if i != source:
                mix(i, pool[source])
    for word in entropy[_POOL:]:
        for i in range(_POOL):
            mix(i, word)
    hashes = _hashes(0x8B51F9DD, 0x58F38DED)
    return [next(hashes)(pool[i % _POOL]) for i in range(words)]


def _hashes(constant: int, factor: int) -> Iterator[Callable[[IntArray], IntArray]]:
    """Functions that each hash words with the next constant."""
    while True:
        before, constant = constant, constant * factor % 2**32

        def hashed(words: IntArray, before: int = before, after: int = constant) -> IntArray:
            product = (words ^ np.uint32(before)) * np.uint32(after)
            return product ^ product >> 16

        yield hashed
