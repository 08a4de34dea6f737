"""Parts that pass through each other as a robot moves: MuJoCo sees hubs, but neither strips nor coils."""

from __future__ import annotations

import numpy as np

from cad.checks.contacts import point_distance
from cad.kit.specification import Specification
from eldir.core.records import FloatArray
from eldir.morphology import Morphology


class Overlap:
    """All pairs of a hub and a spring that it does not hold."""

    def __init__(self, morphology: Morphology, spec: Specification):
        self._ends = morphology.springs
        hub, spring = np.indices((len(morphology.positions), len(self._ends))).reshape(2, -1)
        apart = (self._ends[spring] != hub[:, None]).all(axis=1)
        self._hub, self._spring = hub[apart], spring[apart]
        thick = np.where(morphology.active, spec.coil.outer_diameter, spec.strip.thickness)
        self._reach = 1e-3 * (spec.mass.across_flats + thick[self._spring]) / 2

    def first(self, positions: FloatArray) -> str | None:
        """The pair that overlaps most, in words, with the hubs' centres at `positions` [m], shape (M, 2)."""
        if not len(self._hub):
            return None
        a, b = positions[self._ends[self._spring]].transpose(1, 0, 2)
        gaps = point_distance(positions[self._hub], a, b) - self._reach
        worst = int(gaps.argmin())
        if gaps[worst] >= 0:
            return None
        ends = "-".join(str(end) for end in self._ends[self._spring[worst]])
        return f"mass {self._hub[worst]} and spring {ends}"
