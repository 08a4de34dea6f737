"""Contacts: parts of a body that come too close to each other in their plane, at rest or during the stroke of
the motors [mm].

A mass is the circle around its hexagon. A spring is a bar from mass to mass, as wide as its strip or its
coil. The two planes are equal and far apart, so one of them is enough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir.morphology import Morphology
from eldir_cad.checks.distances import point_distance, segment_distance
from eldir_cad.checks.kinematics import AT_REST, Stroke
from eldir_cad.kit.specification import Specification


@dataclass(frozen=True)
class Contact:
    """Two parts that come too close."""

    parts: tuple[str, str]
    gap: float
    """Least distance between their surfaces [mm]; below 0 they overlap."""
    pose: str
    """The first pose in which they are too close: "at rest", or which motors are hot, as `Stroke.labels`."""


def find_contacts(motion: Stroke, morphology: Morphology, spec: Specification) -> list[Contact]:
    """Pairs of parts closer than the clearance in any pose: first those at rest, then the smallest gap
    first."""
    parts, masses, springs = _Capsules.of(morphology, spec), len(motion.rest), morphology.springs
    i, j = np.triu_indices(len(parts.names), 1)
    own = ((i < masses) & (j >= masses)) & (parts.ends[j] == i[:, None]).any(axis=1)
    # Two masses at the ends of one strip cannot meet: the strip keeps them at a distance. Coils do not.
    linked = {tuple(s) for s in springs[~morphology.active].tolist()}
    is_linked = np.array([(a, b) in linked for a, b in zip(i.tolist(), j.tolist(), strict=True)])
    i, j = i[~own & ~is_linked], j[~own & ~is_linked]
    contacts: dict[int, Contact] = {}
    for pose, label in zip((motion.rest, *motion.poses), (AT_REST, *motion.labels), strict=True):
        starts, stops = parts.segments(pose)
        distances = segment_distance(starts[i], stops[i], starts[j], stops[j])
        gaps = distances - parts.radius[i] - parts.radius[j]
        for k in np.flatnonzero(gaps < spec.clearance).tolist():
            first = contacts.get(k)
            earliest = label if first is None else first.pose
            gap = float(gaps[k]) if first is None else min(first.gap, float(gaps[k]))
            contacts[k] = Contact((parts.names[i[k]], parts.names[j[k]]), gap, earliest)
    return sorted(contacts.values(), key=lambda c: (c.pose != AT_REST, c.gap))


@dataclass(frozen=True)
class Lead:
    """The wire at one end of a motor."""

    motor: int
    mass: int
    """The mass at which it leaves."""
    clearance: float
    """Smallest distance from the wire to any part but its own mass and motor, in any pose [mm]."""
    nearest: str
    """The nearest part."""
    length: float
    """Length to the top of the robot, in the pose that needs the longest wire [mm]."""


def find_leads(motion: Stroke, morphology: Morphology, spec: Specification) -> list[Lead]:
    """Both wires of every motor, in the order of the motors. They leave outwards, at right angles to the
    plane."""
    parts, masses = _Capsules.of(morphology, spec), len(motion.rest)
    leads = []
    for motor, spring in enumerate(np.flatnonzero(morphology.active).tolist()):
        a, b = morphology.springs[spring].tolist()
        for mass, other in ((a, b), (b, a)):
            clearances, lengths = [], []
            for pose in (motion.rest, *motion.poses):
                along = (pose[other] - pose[mass]) / np.linalg.norm(pose[other] - pose[mass])
                hole = pose[mass] + spec.guide_at * along
                clearance = point_distance(hole[None], *parts.segments(pose)) - parts.radius
                clearance -= spec.fitting.wire_guide / 2
                clearance[[mass, masses + spring]] = np.inf
                clearances.append(clearance)
                lengths.append(float(pose[:, 1].max() - hole[1]))
            smallest = np.min(clearances, axis=0)
            nearest = int(smallest.argmin())
            leads.append(Lead(motor, mass, float(smallest[nearest]), parts.names[nearest], max(lengths)))
    return leads


@dataclass(frozen=True, eq=False)
class _Capsules:
    """Masses, then springs, as capsules: segments with a radius. A mass is a segment of no length."""

    names: list[str]
    ends: IntArray
    """Masses at both ends of each segment, shape (parts, 2)."""
    radius: FloatArray
    offset: FloatArray
    """Distance from a mass's centre to the start of the segment; without it the springs of one mass would
    touch."""

    @classmethod
    def of(cls, morphology: Morphology, spec: Specification) -> _Capsules:
        masses, active, springs = len(morphology.positions), morphology.active, morphology.springs
        names = [f"mass {i}" for i in range(masses)]
        names += [f"spring {i} ({a}-{b})" for i, (a, b) in enumerate(springs.tolist())]
        ends = np.concatenate([np.repeat(np.arange(masses)[:, None], 2, axis=1), springs])
        half = np.where(active, spec.coil.outer_diameter / 2, spec.strip.thickness / 2)
        radius = np.concatenate([np.full(masses, spec.mass.across_corners / 2), half])
        begin = np.where(active, spec.coil_seat, spec.mass.across_flats / 2)
        return cls(names, ends, radius, np.concatenate([np.zeros(masses), begin]))

    def segments(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Both ends of every segment, shape (parts, 2) each."""
        a, b = pose[self.ends[:, 0]], pose[self.ends[:, 1]]
        length = np.maximum(np.linalg.norm(b - a, axis=1), 1e-9)
        cut = np.minimum(self.offset / length, 0.5)[:, None] * (b - a)
        return a + cut, b - cut
