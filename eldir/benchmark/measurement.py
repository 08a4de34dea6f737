"""What all measurements share: the same robots, timing in turns, and the files of the result."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.core.files import new_folder, write_bytes, write_text
from eldir.core.installation import processor
from eldir.core.pictures import png
from eldir.core.records import FloatArray
from eldir.core.version import __version__
from eldir.genotype import Genotype, fill, random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SMALL_SPRINGS = 62


def big(n: int, seed: int = 1) -> list[Morphology]:
    """Random bodies on the paper's lattice: 176 springs on average, half of them motors."""
    lattice = Lattice()
    return [develop(lattice, g) for g in random_genotypes(lattice, n, np.random.default_rng(seed))]


def small(n: int, seed: int = 1) -> list[Morphology]:
    """Bodies on the same lattice, grown triangle by triangle until they have 62 springs or a few more."""
    lattice, rng = Lattice(), np.random.default_rng(seed)
    return [develop(lattice, _grown(lattice, rng, _SMALL_SPRINGS)) for _ in range(n)]


POPULATIONS: dict[str, Callable[[int], list[Morphology]]] = {"big": big, "small": small}


def without_motors(body: Morphology) -> Morphology:
    """The same body with all springs passive."""
    return replace(body, active=np.zeros(len(body.springs), bool))


def _grown(lattice: Lattice, rng: np.random.Generator, springs: int) -> Genotype:
    body = np.zeros((lattice.rows, lattice.columns), bool)
    body[rng.integers(lattice.rows), rng.integers(lattice.columns)] = True
    while lattice.expressed_springs(body).sum() < springs:
        beside = np.zeros_like(body)
        beside[1:] |= body[:-1]
        beside[:-1] |= body[1:]
        beside[:, 1:] |= body[:, :-1]
        beside[:, :-1] |= body[:, 1:]
        body[tuple(rng.choice(np.argwhere(beside & ~body)))] = True
    motors = rng.random(len(lattice.springs)) < 0.5
    return Genotype(fill(lattice, body), motors)


Variant = Callable[[], object]


def time_in_turns(
    variants: Mapping[str, Variant], turns: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, FloatArray]:
    """Seconds of every variant in every turn, shape (turns,), after one warm-up call of each.

    `time.process_time` counts computing but not waiting; use it for one thread.
    """
    for variant in variants.values():
        variant()
    seconds: dict[str, FloatArray] = {name: np.empty(turns) for name in variants}
    for turn in range(turns):
        for name, variant in variants.items():
            began = clock()
            variant()
            seconds[name][turn] = clock() - began
    return seconds


def ratio(seconds: Mapping[str, FloatArray], variant: str, to: str) -> float:
    """Time of one variant relative to another: the median over turns."""
    return float(np.median(seconds[variant] / seconds[to]))


@contextmanager
def limit_threads(n: int) -> Iterator[None]:
    """Limits the engine to `n` threads inside the context."""
    before = os.environ.get("ELDIR_THREADS")
    os.environ["ELDIR_THREADS"] = str(n)
    try:
        yield
    finally:
        if before is None:
            del os.environ["ELDIR_THREADS"]
        else:
            os.environ["ELDIR_THREADS"] = before


def save(
    out: Path, name: str, values: dict[str, Any], figure: Figure, other_programs: float | None = None
) -> None:
    """Writes a new folder `out` with `name`.json and `name`.png. `other_programs`: share of the processor
    that they used (`eldir.benchmark.other_programs`); None if unknown."""
    with new_folder(out) as folder:
        head = {
            "format": f"eldir-benchmark-{name}/1",
            "version": __version__,
            "machine": machine(other_programs),
        }
        write_text(folder / f"{name}.json", json.dumps(head | values, indent=1) + "\n")
        write_bytes(folder / f"{name}.png", png(figure))


def say(line: str) -> None:
    """Prints a line of progress to stderr."""
    print(line, file=sys.stderr)


def machine(other_programs: float | None = None) -> dict[str, Any]:
    """The machine on which the figures were measured, and what other programs used of its processor."""
    name = processor()["processor"] or platform.machine()
    return {
        "processor": name,
        "cores": os.cpu_count() or 1,
        "system": platform.platform(),
        "other_programs": other_programs,
    }
