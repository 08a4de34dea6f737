"""The table of docs/reference/second-physics-measured.md:
`python -m tests.hardware.virtual.second_physics_table`.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from eldir.built.gait import Gait, free_lengths
from eldir_cad.multibody.model import Numerics
from eldir_hardware.virtual.mujoco_body import MujocoMotion
from tests.calibration.dynamics.hidden_rigs import PHASE, walker
from tests.hardware.virtual.multibody_models import FREE, robot, walk

CYCLES = 2
SETTINGS = (
    Numerics(step=0.05e-3, contact_time=0.1e-3),
    Numerics(step=0.1e-3, contact_time=0.2e-3),
    Numerics(step=0.1e-3, contact_time=0.5e-3),
    Numerics(step=0.25e-3, contact_time=0.5e-3),
    Numerics(),
    Numerics(step=0.5e-3, contact_time=1e-3),
    Numerics(contact_time=5e-3),
    Numerics(contact_time=20e-3),
    Numerics(impratio=1.0),
    Numerics(impratio=1000.0),
    Numerics(impedance=0.9),
    Numerics(contact_time=20e-3, impratio=1.0, impedance=0.9),
)


def main() -> None:
    """Print one row for each setting."""
    body = walker().morphology
    feet = np.exp(0.1 * np.random.default_rng(3).standard_normal(len(body.positions)))
    plain = robot(body)
    hubs = [replace(h, friction=h.friction * f) for h, f in zip(plain.hubs, feet.tolist(), strict=True)]
    table = free_lengths(Gait(20.0, np.array([0.0, PHASE]), np.array([0.3, 0.3])), cycles=CYCLES)
    shapes = None
    for numerics in SETTINGS:
        model, begun = replace(plain, hubs=hubs, numerics=numerics), time.process_time()
        found, counted = walk(model, table, CYCLES)
        spent = (time.process_time() - begun) / table.interval / (len(table.lengths) - 1) * 123
        own = counted - counted.mean(axis=1, keepdims=True)
        shapes = own if shapes is None else shapes
        standing = MujocoMotion(model, FREE)
        cold = np.full((301, 2), FREE[0])
        standing.follow(cold, 0.05)
        before = standing.positions
        standing.follow(cold, 0.05)
        creep = np.abs(standing.positions - before).max() / 15 * 123
        print(
            f"| {1e3 * numerics.step:g} | {1e3 * numerics.contact_time:g} | {numerics.impratio:g} | "
            f"{numerics.impedance:g} | {found:.3f} | {1e3 * np.sqrt(np.mean((own - shapes) ** 2)):.3f} | "
            f"{1e3 * np.abs(own - shapes).max():.2f} | {1e3 * creep:.3f} | {spent:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
