"""Compositional pattern-producing networks (Stanley 2007): a few functions, composed, paint a pattern.

A network is a list of genes with historical markings (NEAT, Stanley and Miikkulainen 2002), so that two
networks of a run can be aligned. A link's marking is the pair of its nodes' numbers; a hidden node's number
is a digest of the link that it split. The same innovation therefore has the same marking in every process,
on any number of threads, without a counter that all share.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eldir.core.arguments import require_value
from eldir.core.records import BoolArray, FloatArray, IntArray, Record

INPUTS = ("x", "y", "radius", "bias")
"""Nodes 0 to 3: the place, from -1 to 1, its distance from the middle, and 1."""
OUTPUTS = ("fill", "motor", "phase")
"""Nodes 4 to 6."""
FIRST_HIDDEN = len(INPUTS) + len(OUTPUTS)
FUNCTIONS = (np.sin, lambda x: 2.0 * np.exp(-x * x) - 1.0, np.tanh, np.abs, lambda x: x)
"""Functions of nodes: sine, Gaussian from -1 to 1, hyperbolic tangent, absolute value, identity."""


@dataclass(frozen=True, eq=False)
class Cppn(Record):
    """A network of N nodes, without its inputs, and L links; nodes in order of their numbers, links in order
    of their two nodes."""

    nodes: IntArray
    """Numbers of outputs and hidden nodes, shape (N,)."""
    functions: IntArray
    """Index in `FUNCTIONS` of each node, shape (N,)."""
    links: IntArray
    """Numbers of the nodes where each link begins and ends, shape (L, 2)."""
    weights: FloatArray
    """Weight of each link, shape (L,)."""
    enabled: BoolArray
    """Whether each link is used, shape (L,). Links that are not used are inherited too."""

    def __post_init__(self) -> None:
        self._set_array("nodes", np.int64, (None,))
        self._set_array("functions", np.int64, (len(self.nodes),))
        self._set_array("links", np.int64, (None, 2))
        self._set_array("weights", np.float64, (len(self.links),))
        self._set_array("enabled", bool, (len(self.links),))
        outputs = np.arange(len(INPUTS), FIRST_HIDDEN)
        known = np.isin(outputs, self.nodes).all() and np.isin(self.links[:, 1], self.nodes).all()
        known &= np.isin(self.links[:, 0], [*range(len(INPUTS)), *self.nodes.tolist()]).all()
        require_value("nodes of a network", bool(known), "all outputs, and both ends of all links")
        in_range = ((self.functions >= 0) & (self.functions < len(FUNCTIONS))).all()
        require_value("functions of a network", bool(in_range), f"0 to {len(FUNCTIONS) - 1}")
        require_value("links of a network", len(self.order) == len(self.nodes), "no circle")

    @cached_property
    def order(self) -> list[int]:
        """The nodes, each after those that lead to it."""
        hidden = self.links[self.links[:, 0] >= len(INPUTS)].tolist()
        sources = {n: {s for s, t in hidden if t == n} for n in self.nodes.tolist()}
        found: list[int] = []
        while sources:
            ready = sorted(n for n, before in sources.items() if not before)
            if not ready:  # a circle
                break
            sources = {n: before.difference(ready) for n, before in sources.items() if n not in ready}
            found += ready
        return found

    def paint(self, places: FloatArray) -> FloatArray:
        """Values of fill, motor and phase at P places of x and y from -1 to 1: from shape (P, 2) to
        (P, 3)."""
        radius = np.hypot(*places.T)
        values = dict(enumerate([*places.T, radius, np.ones(len(places))]))
        functions = dict(zip(self.nodes.tolist(), self.functions.tolist(), strict=True))
        used = list(zip(self.links[self.enabled].tolist(), self.weights[self.enabled].tolist(), strict=True))
        for node in self.order:
            total = np.zeros(len(places))
            for (source, target), weight in used:
                if target == node:
                    total += weight * values[source]
            values[node] = FUNCTIONS[functions[node]](total)
        return np.stack([values[node] for node in range(len(INPUTS), FIRST_HIDDEN)], axis=1)


def node_number(source: int, target: int, taken: Collection[int]) -> int:
    """The number of the node that splits a link, 63 bits. Where a network has split this link before, the
    next one of the same series."""
    repeat = 0
    while True:
        name = f"{source} {target} {repeat}".encode()
        number = int.from_bytes(hashlib.blake2b(name, digest_size=8).digest(), "big") >> 1
        if number >= FIRST_HIDDEN and number not in taken:
            return number
        repeat += 1
