"""The table of robots out of their plane in docs/reference/second-physics-measured.md:
`python -m tests.calibration.transfer.biplane_table DESIGN`; with a number behind it, of as many rigs whose
outputs' currents are drawn: of one output for each face, or with `series` behind that, for each motor; with
`matched` the springs of a motor are chosen in pairs; with `springs`, `strips` or `feet` these are equal on
both faces, and with `level` the table does not slope sideways.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations

import numpy as np

from eldir.built.gait import FreeLengths, Gait, heat_faces, read_gait
from eldir.design import Design
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir_cad.kit import PRINTER
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.biplane import (
    Biplane,
    build_biplane,
    with_lateral_rotation,
    with_yielding_connectors,
)
from eldir_calibration.transfer.biplane_walks import measure_biplane_walk
from eldir_calibration.transfer.mujoco_walks import (
    FINE_NUMERICS,
    measure_walk,
    sample_face_springs,
)
from eldir_hardware.planning.workshop import make_workshop
from eldir_hardware.virtual.biplane_body import sample_biplane

CYCLES, SEEDS = 2, range(1, 7)
OUTPUT_CURRENT = 0.03
"""Standard deviation of an output's current from that of its rig."""
SPARES, RULER = 4, 0.5e-3
"""Springs more than a robot has, from which pairs are chosen; standard deviation of a measured length [m]."""
SPRINGS = make_workshop().springs
MILLIMETRE = np.arctan(1 / 49.6)
"""Rotation of a strip whose ends are 1 mm beside each other [rad]."""


def faces(gait: Gait, front: SpringParameters, back: SpringParameters) -> FreeLengths:
    return heat_faces(gait, [front, back] * len(gait.phase), CYCLES)


def cases(design: Design, gait: Gait) -> Iterator[tuple[str, Biplane, FreeLengths]]:
    """What differs, the model, and free lengths of its coils."""
    body, parts = design.morphology, (load_specification(), load_printer(PRINTER))
    alike, nominal = faces(gait, SPRINGS, SPRINGS), build_biplane(body, *parts)
    yield "nothing", nominal, alike
    fine = replace(nominal, plane=replace(nominal.plane, numerics=FINE_NUMERICS))
    yield "nothing, steps of 0.1 ms", fine, alike
    yield "nothing, connectors yield", with_yielding_connectors(nominal), alike
    rng = np.random.default_rng(1)
    feet = np.exp(0.1 * rng.standard_normal((2, len(body.positions))))
    yield "feet, 10 %", build_biplane(body, *parts, friction_factors=feet), alike
    yield "table 2 degrees sideways", replace(nominal, side_tilt=np.radians(2.0)), alike
    longer, shorter = (
        replace(SPRINGS, cold_length=SPRINGS.cold_length + d, hot_length=SPRINGS.hot_length + d)
        for d in (1e-3, -1e-3)
    )
    yield "coils 2 mm", nominal, faces(gait, longer, shorter)
    currents = {}
    for part in (0.01, 0.02, 0.03):
        warm, cool = (replace(SPRINGS, current_limit=SPRINGS.current_limit * (1 + d)) for d in (part, -part))
        currents[part] = faces(gait, warm, cool)
    for part, table in currents.items():
        yield f"current +-{part:.0%}", nominal, table
        yield f"current +-{part:.0%}, play 1 mm", with_lateral_rotation(nominal, MILLIMETRE), table
        yield f"current +-{part:.0%}, without play", with_lateral_rotation(nominal, 0.0), table
    yield "current +-2 %, connectors yield", with_yielding_connectors(nominal), currents[0.02]
    for seed in SEEDS:
        rig = RigTolerances().perturb_by_seed(SPRINGS, seed)
        own = sample_face_springs(len(gait.phase), seed, rig)
        sample, table = sample_biplane(body, seed), heat_faces(gait, own, CYCLES)
        yield f"all, seed {seed}", sample, table
        yield f"all, seed {seed}, play 1 mm", with_lateral_rotation(sample, MILLIMETRE), table
        yield f"all, seed {seed}, without play", with_lateral_rotation(sample, 0.0), table


def drawn_cases(
    design: Design, gait: Gait, rigs: int, words: Sequence[str]
) -> Iterator[tuple[str, Biplane, FreeLengths]]:
    """Rigs whose springs, parts and outputs' currents are drawn. `words` as in the command: with `series` an
    output feeds both springs of a motor, otherwise all of a face."""
    for seed in range(101, 101 + rigs):
        on_rig = RigTolerances().perturb_by_seed(SPRINGS, seed)
        own = sample_face_springs(len(gait.phase), seed, on_rig)
        if "matched" in words:
            own = choose_pairs(gait, on_rig, own, seed)
        if "springs" in words:
            own = [SpringParameters.mean(own[i - i % 2 : i - i % 2 + 2]) for i in range(len(own))]
        outputs = len(gait.phase) if "series" in words else 2
        by = 1 + OUTPUT_CURRENT * np.random.default_rng([seed, 9]).standard_normal(outputs)
        currents = np.repeat(by, 2) if "series" in words else np.tile(by, len(gait.phase))
        heated = [
            replace(s, current_limit=s.current_limit * part) for s, part in zip(own, currents, strict=True)
        ]
        body = with_equal_parts(sample_biplane(design.morphology, seed), words)
        yield f"drawn {seed}", body, heat_faces(gait, heated, CYCLES)


def with_equal_parts(body: Biplane, words: Sequence[str]) -> Biplane:
    """The robot with the mean of both faces on each, of what `words` names, or on a table that is level
    sideways."""
    front, back = body.faces
    if "strips" in words:
        pairs = zip(front.strips, back.strips, strict=True)
        strips = [replace(a, length=(a.length + b.length) / 2) for a, b in pairs]
        front, back = replace(front, strips=strips), replace(back, strips=strips)
    if "feet" in words:
        friction = (front.friction + back.friction) / 2
        front, back = replace(front, friction=friction), replace(back, friction=friction)
    return replace(body, front=front, back=back, side_tilt=0.0 if "level" in words else body.side_tilt)


def choose_pairs(
    gait: Gait, on_rig: SpringParameters, drawn: list[SpringParameters], seed: int
) -> list[SpringParameters]:
    """The springs of a robot, in pairs of about the same length, cold and at the end of a pulse. They are
    chosen from those `drawn` and `SPARES` others, measured at one place of the bench. In the robot the air
    cools them as it cools those drawn: that is a matter of the place."""
    spares, ruler = np.random.default_rng([seed, 77]), np.random.default_rng([seed, 78])
    pool = drawn + [RigTolerances().perturb_one(on_rig, spares) for _ in range(SPARES)]
    hot = [faces(gait, s, s).lengths[:, 0].max() for s in (cooled_as(s, on_rig) for s in pool)]
    measured = np.stack([hot, [s.cold_length for s in pool]], axis=1)
    measured += RULER * ruler.standard_normal(measured.shape)
    motors = len(gait.phase)
    choices = combinations(combinations(range(len(pool)), 2), motors)
    pairs = min(
        (choice for choice in choices if len(set(chain(*choice))) == 2 * motors),
        key=lambda choice: sum(((measured[a] - measured[b]) ** 2).sum() for a, b in choice),
    )
    return [cooled_as(pool[k], place) for k, place in zip(chain(*pairs), drawn, strict=True)]


def cooled_as(spring: SpringParameters, other: SpringParameters) -> SpringParameters:
    return replace(spring, convection_fan=other.convection_fan, convection_still=other.convection_still)


def main() -> None:
    """Print one row for each case: the walk in the plane, in space, yaw, roll, drift, processor times."""
    design = Design.load(sys.argv[1])
    gait, known = read_gait(design), {}
    assert gait is not None
    rigs = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    drawn = drawn_cases(design, gait, rigs, sys.argv[3:])
    for what, model, table in drawn if rigs else cases(design, gait):
        mean = replace(table, lengths=table.lengths.reshape(len(table.lengths), -1, 2).mean(axis=2))
        key = mean.lengths.tobytes(), model.plane.tilt, model.plane.hubs[0].friction, model.plane.numerics
        if key not in known:
            begun = time.process_time()
            flat = measure_walk(model.plane, design.morphology, mean, CYCLES, SPRINGS)
            known[key] = flat.displacement, time.process_time() - begun
        begun = time.process_time()
        walk = measure_biplane_walk(model, design.morphology, table, CYCLES, SPRINGS)
        spent = time.process_time() - begun
        print(
            f"| {what} | {known[key][0]:.2f} | {walk.displacement:.2f} {walk.fault} | "
            f"{np.degrees(walk.yaw):.0f} | {np.degrees(walk.roll):.1f} | {walk.drift:.2f} | "
            f"{known[key][1]:.0f} | {spent:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
