"""`python -m benchmarks.foreign_physics DESIGN...`: robots that learn on rigs with physics the engine lacks.

The rigs are those of `benchmarks.adaptation`, moved by MuJoCo with parameters far from the kit, and each has
one thing more, which no parameter of the engine describes (`PHYSICS`). `eldir adapt` makes its runs there,
then all phases are played on the same rig. Where it advises another current, the robot is adapted with that
too, and phases are played with it. A rig is a line in foreign-physics.jsonl; a later call computes
those that are not in it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.adaptation import Bench
from benchmarks.adaptation_advice import describe_runs
from benchmarks.hidden_robot import Rows
from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir_cad.multibody.biplane import with_lateral_rotation
from eldir_hardware.run import drive
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual import bodies
from eldir_hardware.virtual.biplane_body import BiplaneBody, BiplaneMotion, sample_biplane
from eldir_hardware.virtual.mujoco_body import MujocoBody, MujocoMotion, sample_multibody
from eldir_hardware.virtual.rig import BodyFrame, DrivenBody, VirtualRig

SEEDS = range(41, 46)
"""Of the rigs, one for each physics; chosen before any of them had been simulated."""
COIL_PLAY = 2e-3
"""Change of a coil's length that needs no force [m]: a millimetre at either end."""
AT_REST, SLIDING, STRIBECK_SPEED = 1.3, 0.7, 5e-3
"""Friction of a foot over its nominal one, at rest and fast, and the speed at which a part 1/e of the
difference is left [m/s]."""
DRIFT = 0.10, 0.25
"""Range of the relative growth of a spring's resistance in `DRIFT_TIME`."""
DRIFT_TIME = 180.0
"""[s], from power-on."""
COOLING_SPREAD, BACK_COOLING = 0.2, 0.8
"""Standard deviation of the logarithm of a spring's convection, and that of the back face, which the front
one shields from the fan, over the front one's."""
LATERAL_PLAY = np.arctan(1 / 49.6)
"""Rotation of a strip whose ends are 1 mm beside each other [rad]."""


class StribeckFriction(MujocoMotion):
    """Feet hold better at rest than in motion."""

    def _choose_friction(self) -> None:
        super()._choose_friction()
        speeds = self.data.qvel.reshape(len(self._hubs), -1)
        sliding = np.abs(speeds[:, 0] + self._multibody.corner * speeds[:, 2:].sum(axis=1))
        factor = SLIDING + (AT_REST - SLIDING) * np.exp(-sliding / STRIBECK_SPEED)
        self.model.geom_friction[self._feet, 0] *= factor

    def _command(self, lengths: FloatArray, stiffness: FloatArray) -> None:
        super(MujocoMotion, self)._command(lengths, stiffness)
        self._choose_friction()


class LooseCoils(MujocoMotion):
    """Coils have play at their ends: a change of their length needs no force before it is taken up."""

    def _command(self, lengths: FloatArray, stiffness: FloatArray) -> None:
        slack = np.clip(lengths - self.coil_lengths, -COIL_PLAY / 2, COIL_PLAY / 2)
        super()._command(lengths - slack, stiffness)


class DriftingResistance(VirtualRig):
    """The resistance of each spring grows from power-on, by a factor of its own."""

    def __init__(self, *args: Any, **options: Any):
        super().__init__(*args, **options)
        channels = sorted({entry.channel for entry in self._rig.channels})
        grown = 1 + np.random.default_rng([self._rig.virtual.seed, 41]).uniform(*DRIFT, len(channels))
        self._growth, self._drifted = dict(zip(channels, grown.tolist(), strict=True)), self.clock.now()

    def frame(self, t: float) -> BodyFrame:
        """As of `VirtualRig`."""
        frame, elapsed = super().frame(t), max(0.0, t - self._drifted)
        for channel, factor in self._growth.items():
            self.springs.scale_resistance(channel, factor ** (elapsed / DRIFT_TIME))
        self._drifted += elapsed
        return frame


class UnevenCooling(VirtualRig):
    """The air cools each spring otherwise."""

    def __init__(self, *args: Any, **options: Any):
        super().__init__(*args, **options)
        faces = [face for entry in self._rig.channels for face in entry.faces]
        spread = COOLING_SPREAD * np.random.default_rng([self._rig.virtual.seed, 42]).standard_normal(
            len(faces)
        )
        factors = np.exp(spread) * np.where(np.array(faces) == "back", BACK_COOLING, 1.0)
        self.springs.parameters = [
            replace(s, convection_fan=s.convection_fan * factor, convection_still=s.convection_still * factor)
            for s, factor in zip(self.springs.parameters, factors.tolist(), strict=True)
        ]


def _with_motion(motion: type[MujocoMotion]) -> Callable[..., DrivenBody]:
    """A function as `virtual_body`, whose robot moves so."""

    def virtual_body(
        physics: str, morphology: Any, seed: int, springs: Any, ballast: Any, *more: Any
    ) -> DrivenBody:
        body = MujocoBody(morphology, seed, springs, ballast, *more[:2])
        model = sample_multibody(morphology, seed, ballast, *more[:2])
        body.motion = motion(model, (springs.cold_length, springs.hot_length))
        return body

    return virtual_body


def _in_space(physics: str, morphology: Any, seed: int, springs: Any, ballast: Any, *more: Any) -> DrivenBody:
    """The robot with its two faces apart and 1 mm of lateral play in its sockets."""
    body = BiplaneBody(morphology, seed, springs, ballast, *more[:2])
    model = with_lateral_rotation(sample_biplane(morphology, seed, ballast, *more[:2]), LATERAL_PLAY)
    body.motion = BiplaneMotion(model, (springs.cold_length, springs.hot_length))
    return body


@dataclass(frozen=True)
class Physics:
    """A physics of the virtual rig that the engine lacks."""

    body: Callable[..., DrivenBody] = bodies.virtual_body
    rig: type[VirtualRig] = VirtualRig

    @contextmanager
    def active(self) -> Iterator[None]:
        """Virtual rigs of this process have it meanwhile: `eldir adapt` has no option that could tell it."""
        with patch.object(bodies, "virtual_body", self.body), patch.object(drive, "VirtualRig", self.rig):
            yield


PHYSICS = {
    "friction falls with speed": Physics(body=_with_motion(StribeckFriction)),
    "play of the coils": Physics(body=_with_motion(LooseCoils)),
    "drift of resistance": Physics(rig=DriftingResistance),
    "uneven cooling": Physics(rig=UnevenCooling),
    "out of the plane, lateral play": Physics(body=_in_space),
}


@dataclass(frozen=True)
class ForeignBench(Bench):
    """A bench of `benchmarks.adaptation` with such a physics."""

    physics: str = next(iter(PHYSICS))

    def drive(self, schedule: ActuationSchedule, log: Path) -> None:
        """As of `HiddenRig`."""
        with PHYSICS[self.physics].active():
            super().drive(schedule, log)

    def true_walk(self, schedule: ActuationSchedule) -> float:
        """As of `Bench`."""
        with PHYSICS[self.physics].active():
            return super().true_walk(schedule)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table; the rows are kept in foreign-physics.jsonl."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.foreign_physics", description=__doc__)
    parser.add_argument("designs", nargs="+", type=Path, metavar="DESIGN", help="one for each rig in turn")
    parser.add_argument("--out", type=Path, required=True, help="folder, new or of an earlier call")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--only", choices=PHYSICS, nargs="+", default=list(PHYSICS), metavar="PHYSICS")
    given = parser.parse_args(arguments)
    rows = Rows(given.out / "foreign-physics.jsonl")
    print("| physics | design, rig | runs: predicted, filmed | last schedule | best of all phases |")
    print("| --- | --- | --- | --- | --- |")
    for name, seed, design in zip(PHYSICS, SEEDS, cycle(given.designs), strict=False):
        if name not in given.only:
            continue
        file = design.resolve()
        row = rows.find(file, seed)
        if row is None:
            row = {"physics": name} | _row(
                ForeignBench(file, seed, given.out / str(seed), physics=name), given.runs
            )
            rows.add(row)
        print(_describe(row), flush=True)


def _row(bench: ForeignBench, runs: int) -> dict[str, Any]:
    try:
        return bench.row(runs, exhaustive=True, as_advised=True)
    except InputError as error:
        return {"design": str(bench.design_file), "seed": bench.seed, "refused": str(error)}


def _describe(row: dict[str, Any]) -> str:
    where = f"| {row['physics']} | {row['design']}, {row['seed']} |"
    if "refused" in row:
        return f"{where} {row['refused']} | | |"
    runs = describe_runs(row["runs"])
    if row["then"] is not None:
        runs += f"; at {row['current_a']:g} A: {describe_runs(row['then']['runs'])}"
    return f"{where} {runs} | {row['last']:+.2f} | {row['best_of_all_phases']:+.2f} |"


if __name__ == "__main__":
    main()
