"""Which law of the MuJoCo model a walk depends on: the model with one of them taken away at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from eldir.built.gait import free_lengths
from eldir.built.robot import build
from eldir.built.walking import displacements
from eldir.core.records import Record, Rounded, record
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir_cad.multibody.simpler import SIMPLER
from eldir_calibration.transfer.mujoco_walks import FINE, measured_walk
from eldir_calibration.transfer.transfer import TransferSettings, WalkingDesign
from eldir_hardware.virtual.mujoco_body import drawn_multibody

_EQUAL = 0.05  # body lengths per five cycles: there is nothing to explain
Number = Annotated[float, Rounded(9)]
STEPS = 2 + len(SIMPLER)
"""Steps of the progress for each design."""


@record
class ExplainedWalk(Record):
    """Walks of one nominal robot, with feet and slope of a seed; minus infinity: it falls."""

    file: str
    """Name of the design file."""
    seed: Annotated[int, Field(ge=0)]
    """Random seed of the feet and of the table's slope."""
    engine: Number
    """Walk in eldir's engine [body lengths per five cycles]; null: it falls."""
    mujoco: Number
    """Walk in MuJoCo with all its laws [body lengths per five cycles]; null: it falls."""
    without: dict[str, Number]
    """Walk in MuJoCo without each of its laws [body lengths per five cycles]; null: it falls."""

    @property
    def changes(self) -> dict[str, float]:
        """Change of the walk as each is taken away; NaN where one of both robots falls."""
        with np.errstate(invalid="ignore"):
            return {
                name: float(walk - self.mujoco) if np.isfinite([walk, self.mujoco]).all() else np.nan
                for name, walk in self.without.items()
            }

    @property
    def finding(self) -> str:
        """What was found, as a sentence."""
        if not np.isfinite([self.engine, self.mujoco]).all():
            return "it falls, so no difference can be told"
        apart = self.mujoco - self.engine
        told = f"MuJoCo differs from the engine by {apart:+.2f}"
        remains = {n: abs(apart + c) for n, c in self.changes.items() if np.isfinite(c)}
        falls = [name for name, walk in self.without.items() if not np.isfinite(walk)]
        fallen = f"; it falls without {' or '.join(falls)}" if falls else ""
        nearest = min(remains, key=lambda n: remains[n], default=None)
        if abs(apart) < _EQUAL:
            return f"MuJoCo and the engine differ by less than {_EQUAL:g}{fallen}"
        if nearest is None or remains[nearest] > abs(apart) / 2:
            return f"{told}; taking away one law alone does not explain half of that{fallen}"
        return f"{told}, without {nearest} by {apart + self.changes[nearest]:+.2f}{fallen}"


def explain(
    one: WalkingDesign,
    seed: int,
    settings: TransferSettings,
    progress: Callable[[str, float], None] = lambda _what, _done: None,
) -> ExplainedWalk:
    """Let the nominal robot of a design walk in the engine, in MuJoCo, and there without each law."""
    body, nominal = one.design.morphology, BuiltParameters()
    model = replace(drawn_multibody(body, seed, one.design.ballast, nominal), numerics=FINE)
    springs, cycles = settings.springs, settings.cycles
    table = free_lengths(one.gait, springs, cycles)

    def said(what: str) -> None:
        progress(f"explaining {one.file}: {what}", 1)

    feet = np.array([hub.friction for hub in model.hubs]) / nominal.friction
    parameters = RobotParameters(nominal.with_hubs(), springs, feet=feet)
    robot = build(body, parameters, ballast=one.design.ballast / 2)
    (engine,) = displacements([robot], [table], cycles, (springs.cold_length, springs.hot_length))
    said("MuJoCo")
    whole = measured_walk(model, body, table, cycles, springs).displacement
    said("one law less")
    without = {}
    for name, simpler in SIMPLER.items():
        without[name] = measured_walk(simpler(model), body, table, cycles, springs).displacement
        said(f"without {name}")
    return ExplainedWalk(one.file, seed, float(engine), whole, without)
