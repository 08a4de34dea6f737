"""Hinges and mechanisms: motions of a body in which every spring keeps its length.

To first order the lengths change by R u, with R the rigidity matrix and u the velocities of the
masses. A body in the plane moves rigidly in three ways; every further motion without a change of
length is a degree of freedom: 2 M - 3 - rank R.
"""

from __future__ import annotations

from dataclasses import dataclass

import networkx as nx
import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir.morphology import Morphology

_RANK_TOLERANCE = 1e-9  # of the largest singular value


def rigidity_matrix(positions: FloatArray, springs: IntArray) -> FloatArray:
    """Change of each spring's length per displacement of (x, y) of each mass, shape (S, 2 M)."""
    a, b = springs.T
    along = positions[a] - positions[b]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    matrix = np.zeros((len(springs), len(positions), 2))
    rows = np.arange(len(springs))
    matrix[rows, a], matrix[rows, b] = along, -along
    return matrix.reshape(len(springs), -1)


def degrees_of_freedom(positions: FloatArray, springs: IntArray) -> int:
    """Number of independent motions, without the rigid ones, for masses in exactly these positions."""
    if len(springs) == 0:
        return 2 * len(positions) - 3
    sizes = np.linalg.svd(rigidity_matrix(positions, springs), compute_uv=False)
    rank = int((sizes > _RANK_TOLERANCE * sizes[0]).sum())
    return 2 * len(positions) - 3 - rank


def mechanisms(positions: FloatArray, springs: IntArray) -> FloatArray:
    """One motion for each degree of freedom, without any rigid part, shape (F, M, 2).

    The motions are independent and have the same norm; all their sums are motions too.
    """
    x, y = (positions - positions.mean(axis=0)).T
    one, none = np.ones_like(x), np.zeros_like(x)
    size = np.sqrt((x**2 + y**2).mean()) or 1.0
    rigid = [np.stack(pair, axis=1).ravel() for pair in ((one, none), (none, one), (-y / size, x / size))]
    rows = np.vstack([*rigid, rigidity_matrix(positions, springs)])
    _, sizes, motions = np.linalg.svd(rows)
    rank = int((sizes > _RANK_TOLERANCE * sizes[0]).sum())
    return motions[rank:].reshape(-1, len(positions), 2)


@dataclass(frozen=True)
class Hinge:
    """A mass that joins parts of the body which share no edge there."""

    mass: int
    fans: int
    """Groups of triangles around it that are joined by edges."""
    separates: bool
    """Whether the mass alone holds its parts together: without it the body falls apart."""


def hinges(morphology: Morphology) -> list[Hinge]:
    """Every mass that joins parts of the body by a vertex alone."""
    body = _graph(morphology)
    cuts = set(nx.articulation_points(body))
    found = []
    for mass in sorted(body):
        # Two triangles at a mass share an edge there where a neighbour belongs to both: the
        # neighbours, joined where they have a spring in common, fall into the fans.
        fans = nx.number_connected_components(body.subgraph(body[mass]))
        if fans > 1:
            found.append(Hinge(mass, fans, mass in cuts))
    return found


def _graph(morphology: Morphology) -> nx.Graph:
    graph = nx.Graph()
    graph.add_nodes_from(range(len(morphology.positions)))
    graph.add_edges_from(morphology.springs.tolist())
    return graph
