"""What a simulated robot does that a printed one cannot do: parts pass through each other, and coils that
would buckle stay straight."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eldir.core.records import FloatArray
from eldir.morphology import Morphology
from eldir.parameters.springs import SpringParameters
from eldir_cad.checks.distances import point_distance
from eldir_cad.kit.specification import Specification, load_specification


class ImpossibleMotion:
    """The first overlap of parts and the first coil that would buckle, of a robot in MuJoCo."""

    def __init__(self, morphology: Morphology, springs: SpringParameters):
        """`springs`: the coils, whose size need not be the kit's."""
        coil = springs.coil_diameter + springs.wire_diameter
        self._overlap_check = OverlapCheck(morphology, load_specification(), coil)
        self._morphology, self._overlap, self._buckling = morphology, "", ""

    @property
    def remark(self) -> str:
        """The remark for the log; empty while all that was looked at is possible."""
        return "; ".join(filter(None, (self._overlap, self._buckling)))

    def look(self, time: float, faces: Mapping[str, FloatArray], coil_loads: FloatArray) -> None:
        """Look at the robot `time` after power-on [s].

        `faces`: for the name of each face, or an empty one for both, the hubs' centres as in `worst_pair`.
        `coil_loads`: shortening of each coil over the one at which it buckles, of all motors in their order
        and of each face, shape (A x faces,).
        """
        for face, centres in faces.items():
            if not self._overlap and (parts := self._overlap_check.worst_pair(centres)):
                place = f" of the {face}" if face else ""
                self._overlap = f"{parts}{place} pass through each other, first {_at(time)}"
        if not self._buckling:
            self._buckling = describe_buckling(self._morphology, coil_loads, time)


def describe_buckling(morphology: Morphology, coil_loads: FloatArray, time: float) -> str:
    """The coil that is farthest beyond the shortening at which it buckles, `time` after power-on [s]; empty
    if none is. `coil_loads`: as in `ImpossibleMotion.look`."""
    if not coil_loads.max(initial=0.0) > 1.0:
        return ""
    motor = int(coil_loads.argmax()) * morphology.motors // len(coil_loads)
    ends = "-".join(str(end) for end in morphology.springs[morphology.active][motor])
    return f"the coil of spring {ends} would buckle on a printed robot, first {_at(time)}"


def _at(time: float) -> str:
    return f"{time:.1f} s after power-on"


class OverlapCheck:
    """All pairs of a hub and a spring that it does not hold: parts that may pass through each other as a
    robot moves, since MuJoCo sees hubs, but neither strips nor coils."""

    def __init__(self, morphology: Morphology, spec: Specification, coil: float):
        """`coil`: outer diameter of the coils [m]."""
        self._ends = morphology.springs
        hub, spring = np.indices((len(morphology.positions), len(self._ends))).reshape(2, -1)
        separate = (self._ends[spring] != hub[:, None]).all(axis=1)
        self._hub, self._spring = hub[separate], spring[separate]
        thick = np.where(morphology.active, 1e3 * coil, spec.strip.thickness)
        self._reach = 1e-3 * (spec.mass.across_flats + thick[self._spring]) / 2

    def worst_pair(self, positions: FloatArray) -> str | None:
        """Description of the pair that overlaps most with the hubs' centres at `positions` [m], shape (M, 2),
        or the discs of one face in space, (M, 3); None without overlap."""
        if not len(self._hub):
            return None
        a, b = positions[self._ends[self._spring]].transpose(1, 0, 2)
        gaps = point_distance(positions[self._hub], a, b) - self._reach
        worst = int(gaps.argmin())
        if gaps[worst] >= 0:
            return None
        ends = "-".join(str(end) for end in self._ends[self._spring[worst]])
        return f"mass {self._hub[worst]} and spring {ends}"
