"""Variation of networks: random ones, mutation, and the crossover of aligned genes (NEAT)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eldir.core.records import FloatArray
from eldir.evolution.paper.cppn import FIRST_HIDDEN, FUNCTIONS, INPUTS, Cppn, node_number

MAX_WEIGHT = 8.0
_PERTURBED, _SPREAD = 0.8, 0.5
"""Probability that a weight changes, and the standard deviation of the change."""
_ADD_LINK, _ADD_NODE, _OTHER_FUNCTION, _TOGGLE = 0.2, 0.1, 0.1, 0.05
"""Probabilities of a change of structure. NEAT's are a quarter to a half of them; it has ten times as many
generations."""
_MAX_SPLITS = 4  # of a random network: its pattern is more than one wave

_Genes = dict[tuple[int, int], tuple[float, bool]]


def random_network(rng: np.random.Generator) -> Cppn:
    """All inputs lead to all outputs, with normal weights; up to four links are split."""
    nodes = {number: _draw_function(rng) for number in range(len(INPUTS), FIRST_HIDDEN)}
    pairs = [(source, target) for source in range(len(INPUTS)) for target in nodes]
    genes = {
        pair: (float(w), True) for pair, w in zip(pairs, 2.0 * rng.standard_normal(len(pairs)), strict=True)
    }
    for _ in range(rng.integers(_MAX_SPLITS + 1)):
        _split_link(nodes, genes, rng)
    return _assemble(nodes, genes)


def mutate(network: Cppn, rng: np.random.Generator, strength: float = 1.0) -> Cppn:
    """Change weights by normal numbers, `strength` times as much as usual, and seldom the structure."""
    nodes, genes = _nodes(network), _genes(network)
    changes = _SPREAD * strength * rng.standard_normal(len(genes)) * (rng.random(len(genes)) < _PERTURBED)
    for (pair, (weight, enabled)), change in zip(list(genes.items()), changes, strict=True):
        genes[pair] = float(np.clip(weight + change, -MAX_WEIGHT, MAX_WEIGHT)), enabled
    if rng.random() < _ADD_LINK:
        _add_link(network, genes, rng)
    if rng.random() < _ADD_NODE:
        _split_link(nodes, genes, rng)
    if rng.random() < _OTHER_FUNCTION:
        nodes[list(nodes)[rng.integers(len(nodes))]] = _draw_function(rng)
    if rng.random() < _TOGGLE:
        pair = list(genes)[rng.integers(len(genes))]
        genes[pair] = genes[pair][0], not genes[pair][1]
    return _assemble(nodes, genes)


def cross(fitter: Cppn, other: Cppn, rng: np.random.Generator) -> Cppn:
    """The structure of the fitter network. Genes that both have, by their markings, come from either with
    equal probability; disjoint and excess genes are those of the fitter one."""
    nodes, genes, other_nodes, other_genes = _nodes(fitter), _genes(fitter), _nodes(other), _genes(other)
    for pair, swap in zip(genes, rng.random(len(genes)) < 0.5, strict=True):
        if swap and pair in other_genes:
            genes[pair] = other_genes[pair]
    for node, swap in zip(nodes, rng.random(len(nodes)) < 0.5, strict=True):
        if swap and node in other_nodes:
            nodes[node] = other_nodes[node]
    return _assemble(nodes, genes)


def _add_link(network: Cppn, genes: _Genes, rng: np.random.Generator) -> None:
    """A new link between two nodes of the network, forward in its order, so that none forms a circle."""
    order = network.order
    free = [
        (source, target)
        for k, target in enumerate(order)
        for source in (*range(len(INPUTS)), *order[:k])
        if not len(INPUTS) <= source < FIRST_HIDDEN and (source, target) not in genes
    ]
    if free:
        genes[free[rng.integers(len(free))]] = float(rng.standard_normal()), True


def _split_link(nodes: dict[int, int], genes: _Genes, rng: np.random.Generator) -> None:
    """A node in the middle of a link, which is no longer used; the new path begins with weight 1."""
    used = [pair for pair, (_, enabled) in genes.items() if enabled]
    if not used:
        return
    source, target = used[rng.integers(len(used))]
    node, weight = node_number(source, target, nodes), genes[source, target][0]
    nodes[node] = _draw_function(rng)
    genes[source, target] = weight, False
    genes[source, node], genes[node, target] = (1.0, True), (weight, True)


def _draw_function(rng: np.random.Generator) -> int:
    return int(rng.integers(len(FUNCTIONS)))


def _nodes(network: Cppn) -> dict[int, int]:
    return dict(zip(network.nodes.tolist(), network.functions.tolist(), strict=True))


def _genes(network: Cppn) -> _Genes:
    pairs = [(source, target) for source, target in network.links.tolist()]
    values = zip(network.weights.tolist(), network.enabled.tolist(), strict=True)
    return dict(zip(pairs, values, strict=True))


def _assemble(nodes: Mapping[int, int], genes: _Genes) -> Cppn:
    numbers, pairs = sorted(nodes), sorted(genes)
    weights: FloatArray = np.array([genes[pair][0] for pair in pairs])
    return Cppn(
        np.array(numbers), np.array([nodes[n] for n in numbers]), np.array(pairs, np.int64).reshape(-1, 2),
        weights, np.array([genes[pair][1] for pair in pairs], bool),
    )  # fmt: skip
