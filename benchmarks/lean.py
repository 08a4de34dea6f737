"""`python -m benchmarks.lean RUN`: predicted lean of robots and that in MuJoCo; what widths and wirings gain.

Bodies are the elites of a run of `eldir evolve --objective printed` with their gaits, and random printable
ones with random gaits. Connectors have gaps of 4 to 35 mm, and the faces differ by 2 % of current to either
side or in each coil by its tolerances (decision 65). `--widths` and `--wirings` print tables of the
prediction alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from eldir.built.gait import Gait, heat_faces, read_gait
from eldir.built.robot import build
from eldir.built.walking import TOPPLED_ANGLE, walk
from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.evolution.designs import load_run
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_cad.checks.buildability import check
from eldir_cad.checks.lateral_stability import LateralStability, lean_in_gait, spread_current, summarise
from eldir_cad.checks.strip_law import hub_parameters
from eldir_cad.checks.tipping import CURRENT_SPREAD, with_gap
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.biplane import build_biplane
from eldir_calibration.transfer.biplane_walks import yaw_and_roll
from eldir_calibration.transfer.mujoco_walks import follow_table, sample_face_springs
from eldir_hardware.planning.workshop import make_workshop
from eldir_hardware.virtual.biplane_body import BiplaneMotion

PRINTER, SPEC = load_printer(), load_specification()
SPRINGS = make_workshop().springs
GAPS = (35, 35, 20, 10, 35, 6, 35, 4)
"""Gaps of the connectors in turn [mm]; the kit's is 35."""
WIDTHS = (15, 20, 25, 30, 35, 45, 55)
_PERIOD, _ON = 23.0, 6.0  # of random gaits [s]
_LATTICES, _TRIED, _KEPT, _MAX_HUBS = (Lattice(4, 8), Lattice(6, 6)), 150, 6, 14


@dataclass(frozen=True)
class Case:
    """A robot, its gait, and what differs between its faces."""

    kind: str
    body: Morphology
    gait: Gait
    gap: int
    differs: str
    springs: Sequence[SpringParameters]
    """As of `heat_faces`."""


def collect_bodies(run: Path, rng: np.random.Generator) -> list[tuple[str, Morphology, Gait]]:
    """Elites of a run, and random bodies that pass the build filter and survive in the plane, shuffled."""
    bodies: list[tuple[str, Morphology, Gait]] = []
    for design in load_run(run):
        if (own := read_gait(design)) is not None:
            bodies.append(("evolved", design.morphology, own))
    for lattice in _LATTICES:
        kept = 0
        for genotype in random_genotypes(lattice, _TRIED, rng, 2):
            body = develop(lattice, genotype)
            if not body.motors or len(body.positions) > _MAX_HUBS or not check(body, SPEC, PRINTER).fit:
                continue
            gait = Gait(_PERIOD, rng.integers(0, 8, body.motors) / 8, np.full(body.motors, _ON / _PERIOD))
            robot = build(body, RobotParameters(BuiltParameters().with_hubs(), SPRINGS))
            if np.isfinite(walk(robot, gait, SPRINGS, cycles=1)):
                bodies.append(("random", body, gait))
                kept += 1
            if kept == _KEPT:
                break
    rng.shuffle(bodies)  # type: ignore[arg-type]
    return bodies


def cases(run: Path, seed: int, count: int) -> Iterator[Case]:
    """`count` robots: bodies, gaps and differences in turn."""
    bodies = collect_bodies(run, np.random.default_rng(seed))
    for i in range(count):
        kind, body, gait = bodies[i % len(bodies)]
        gap = GAPS[(i + i // len(bodies)) % len(GAPS)]
        if (i // 2) % 2 == 0:
            differs, springs = "current", spread_current(SPRINGS, body.motors, CURRENT_SPREAD)
        else:
            differs, springs = "coils", sample_face_springs(body.motors, seed + i, SPRINGS)
        yield Case(kind, body, gait, gap, differs, springs)


def lean_in_mujoco(case: Case) -> float:
    """Largest lean [degrees]; 90 for a robot that falls over or whose simulation fails."""
    motion = BiplaneMotion(
        build_biplane(case.body, with_gap(SPEC, case.gap), PRINTER), (SPRINGS.cold_length, SPRINGS.hot_length)
    )
    discs: list[FloatArray] = []
    try:
        follow_table(
            motion, heat_faces(case.gait, case.springs, 1), SPRINGS, lambda: discs.append(motion.discs)
        )
    except EldirError:
        return 90.0
    seen = np.array(discs)
    _, rolls = yaw_and_roll(seen[0].reshape(-1, 3), seen.reshape(len(seen), -1, 3))
    largest = float(np.abs(rolls).max())
    return 90.0 if largest > TOPPLED_ANGLE else float(np.degrees(largest))


def predict(case: Case) -> LateralStability | None:
    """The prediction for the same robot."""
    parts = with_gap(SPEC, case.gap)
    robot = RobotParameters(hub_parameters(parts, PRINTER), SPRINGS)
    leans = lean_in_gait(case.body, case.gait, robot, case.springs, parts, PRINTER)
    return None if leans is None else summarise(leans)


def describe(leans: FloatArray, predicted: Sequence[LateralStability]) -> list[str]:
    """The verdict: rank correlations, and whether a robot fell that was called safe. `leans` in MuJoCo
    [degrees]."""
    ours = np.array([one.lean_deg for one in predicted])
    safe, fell = np.array([one.is_safe for one in predicted]), leans >= 90.0
    stood = ~fell
    return [
        f"rank correlation of the lean, all {len(leans)}: {spearmanr(leans, ours).statistic:.2f}; "
        f"of the {stood.sum()} that did not fall: {spearmanr(leans[stood], ours[stood]).statistic:.2f}",
        f"{fell.sum()} fell; of {safe.sum()} called safe {(safe & fell).sum()} fell; "
        f"{(~safe & stood).sum()} of the others did not",
    ]


def print_widths(run: Path) -> None:
    """Lean, margin, mass and walk of a run's elites for each gap of the connectors."""
    print("| gap [mm] | lean, mean and largest [degrees] | smallest margin | mass [g] | walk |")
    designs = load_run(run)
    for gap in WIDTHS:
        parts = with_gap(SPEC, gap)
        robot = RobotParameters(hub_parameters(parts, PRINTER), SPRINGS)
        found, masses, walks = [], [], []
        for design in designs:
            body, gait = design.morphology, read_gait(design)
            assert gait is not None
            one = predict(Case("", body, gait, gap, "", spread_current(SPRINGS, body.motors, CURRENT_SPREAD)))
            plane = build(body, robot)
            masses.append(2e3 * plane.masses.sum())
            walks.append(walk(plane.coarse(), gait, SPRINGS, cycles=2))
            if one is not None:
                found.append(one)
        leans = [one.lean_deg for one in found]
        margin = min(one.margin_deg for one in found)
        print(
            f"| {gap} | {np.mean(leans):.1f}, {max(leans):.1f} | {margin:.1f} | {np.mean(masses):.1f} | "
            f"{np.mean(np.maximum(walks, 0)):.2f} |",
            flush=True,
        )


def print_wirings(run: Path, draws: int) -> None:
    """Lean of a run's elites whose two coils have a channel each, and in series, which makes their currents
    equal."""
    found: dict[str, list[float]] = {"a channel each": [], "in series": []}
    for number, design in enumerate(load_run(run)):
        body, gait = design.morphology, read_gait(design)
        assert gait is not None
        for draw in range(draws):
            rng = np.random.default_rng([number, draw])
            own = [SPRINGS.perturb(rng) for _ in range(2 * body.motors)]
            parts = rng.choice([-1, 1]) * np.tile([CURRENT_SPREAD, -CURRENT_SPREAD], body.motors)
            spread = [spread_current(one, 1, part)[0] for one, part in zip(own, parts.tolist(), strict=True)]
            for name, springs in (("a channel each", spread), ("in series", own)):
                one = predict(Case("", body, gait, 35, "", springs))
                if one is not None:
                    found[name].append(one.lean_deg)
    for name, leans in found.items():
        print(
            f"{name}: lean {np.mean(leans):.1f} degrees on average, 95 % below {np.quantile(leans, 0.95):.1f}"
        )


def main() -> None:
    """Print the table that was asked for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lean", description=__doc__)
    parser.add_argument("run", type=Path, help="folder of eldir evolve --objective printed")
    parser.add_argument("--seed", type=int, default=2000, help="random seed of bodies, gaits and coils")
    parser.add_argument("--robots", type=int, default=32, help="robots in MuJoCo, 20 s each")
    parser.add_argument("--widths", action="store_true", help="print the table of widths")
    parser.add_argument(
        "--wirings", type=int, metavar="DRAWS", help="compare wirings by as many draws of coils"
    )
    arguments = parser.parse_args()
    if arguments.widths:
        print_widths(arguments.run)
    elif arguments.wirings:
        print_wirings(arguments.run, arguments.wirings)
    else:
        print_judgement(cases(arguments.run, arguments.seed, arguments.robots))


def print_judgement(robots: Iterator[Case]) -> None:
    """Print a row for each robot, and the verdict."""
    print(
        "| body | hubs | gap [mm] | what differs | tips at | predicted lean | margin | lean in MuJoCo | ms |"
    )
    leans, predictions = [], []
    for case in robots:
        begun = time.process_time()
        if (one := predict(case)) is None:
            continue
        spent = 1e3 * (time.process_time() - begun)
        leans.append(lean_in_mujoco(case))
        predictions.append(one)
        print(
            f"| {case.kind} | {len(case.body.positions)} | {case.gap} | {case.differs} "
            f"| {one.tipping_deg:.0f} | {one.lean_deg:.1f} | {one.margin_deg:.0f} | {leans[-1]:.1f} "
            f"| {spent:.0f} |",
            flush=True,
        )
    print("\n".join(describe(np.array(leans), predictions)))


if __name__ == "__main__":
    main()
