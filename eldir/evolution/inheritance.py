"""Inherited weights: the part of a parent's learned controller that fits its offspring.

The paper's robots learn from nothing; it lists weights passed on from parent to offspring among what may
help.
"""

from __future__ import annotations

import numpy as np

from eldir.controller import CPGS, HIDDEN, Controller
from eldir.morphology import Morphology


def inherit(parent: Morphology, taught: Controller, child: Morphology, fresh: Controller) -> Controller:
    """A controller for `child` with the parent's weights of all masses and motors that both have at the same
    place of the lattice, and all other weights as in `fresh`."""
    w1 = fresh.w1.copy()
    w1[:, :CPGS] = taught.w1[:, :CPGS]
    _, old, new = np.intersect1d(parent.vertices, child.vertices, return_indices=True)
    sensed = w1[:, CPGS:].reshape(HIDDEN, -1, 4)  # a view: dx, dy, vx, vy of each mass
    sensed[:, new] = taught.w1[:, CPGS:].reshape(HIDDEN, -1, 4)[:, old]
    w2, b2 = fresh.w2.copy(), fresh.b2.copy()
    theirs, ours = (m.lattice_springs[m.active] for m in (parent, child))
    _, old, new = np.intersect1d(theirs, ours, return_indices=True)
    w2[new], b2[new] = taught.w2[old], taught.b2[old]
    return Controller(w1, taught.b1, w2, b2)
