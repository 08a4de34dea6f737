"""The robot that a seed gives a virtual rig with `parameter_spread: large`, as only benchmarks may know it.

Its walks are those of the virtual rig without board, camera and guardian: the same model in MuJoCo, moved by
the same springs. Thus a gait takes seconds instead of a minute.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from eldir.built.gait import CYCLES, Gait, heat_faces
from eldir.built.samples import NominalRobots, simulate_most_probable
from eldir.core.files import write_text
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.parameters.robot import RobotParameters, sample_feet
from eldir.parameters.springs import SpringParameters
from eldir_cad.multibody.model import Multibody
from eldir_calibration.adaptation.loop import adapt
from eldir_calibration.adaptation.runs import Adaptation, AdaptationConfig
from eldir_calibration.transfer.mujoco_walks import measure_walk
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import CURRENT_LIMIT_A, virtual_rig
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.bodies import far_robot
from eldir_hardware.virtual.mujoco_body import sample_multibody

_ASSUMED = "tolerances: {current: 0.05, ambient_min_c: 18, ambient_max_c: 30,"
_MEASURED = "tolerances: {current: 0.02, ambient_min_c: 19, ambient_max_c: 25,"


@dataclass(frozen=True)
class HiddenRobot:
    """A design on a virtual rig whose channels heat one spring each, in the order of motors, front and
    back."""

    design: Design
    rig: Rig
    current: float = 1.0
    """Current as a multiple of that which the rig file gives."""

    @cached_property
    def _far(self) -> RobotParameters:
        return far_robot(self.rig)

    @cached_property
    def springs(self) -> tuple[SpringParameters, ...]:
        """The springs, front and back of each motor in turn."""
        seed = self.rig.virtual.seed
        tolerances = self.rig.spring_tolerances()
        common = tolerances.perturb_by_seed(self._far.springs, seed)
        deviations = np.random.default_rng([seed, 3])
        common = replace(common, current_limit=self.current * common.current_limit)
        every = [
            tolerances.perturb_one(common, deviations) for entry in self.rig.channels for _ in entry.faces
        ]
        return tuple(every[: 2 * self.design.morphology.motors])

    @cached_property
    def model(self) -> Multibody:
        """The robot in MuJoCo."""
        design = self.design
        return sample_multibody(
            design.morphology,
            self.rig.virtual.seed,
            design.ballast,
            self._far.printed,
            design.printed_terrain,
        )

    def walk(self, gait: Gait, cycles: int = CYCLES) -> float:
        """Walk in MuJoCo, with the time steps of the virtual rig [body lengths per five cycles]; minus
        infinity where it falls or folds, or buckles a coil."""
        motors, body = self.design.morphology.motors, self.design.morphology
        table = heat_faces(gait, self.springs, cycles, body.motor_hubs)
        lengths = table.lengths.reshape(-1, motors, 2).mean(axis=2)
        springs = self._far.springs
        return measure_walk(self.model, body, replace(table, lengths=lengths), cycles, springs).displacement

    def stroke(self, gait: Gait) -> tuple[float, float]:
        """Part of the stroke that a gait uses, and the stroke itself [m]: means over the springs, over one
        cycle that repeats."""
        table = heat_faces(gait, self.springs, 1, self.design.morphology.motor_hubs)
        moved = np.ptp(table.lengths[table.first_cycle :], axis=0)
        possible = np.array([s.hot_length - s.cold_length for s in self.springs])
        return float((moved / possible).mean()), float(possible.mean())

    def engine_walks(self, gaits: Sequence[Gait], cycles: int = 1) -> FloatArray:
        """Walks of the same robot in the engine, coarse and on a level table, shape (gaits,)."""
        seed, body = self.rig.virtual.seed, self.design.morphology
        printed = self._far.printed.with_hubs()
        own = [SpringParameters.mean(self.springs[i : i + 2]) for i in range(0, len(self.springs), 2)]
        noise = np.random.default_rng([seed, 2]).standard_normal(len(body.springs))
        robot = RobotParameters(
            replace(printed, geometry=0.0),
            self._far.springs,
            np.where(body.active, 0.0, self._far.printed.geometry * noise),
            feet=sample_feet(len(body.positions), np.random.default_rng([seed, 6])),
            own_springs=tuple(own),
        )
        robots = NominalRobots(body, robot, self.design.ballast / 2, self.design.printed_terrain)
        return simulate_most_probable(robots, gaits, cycles=cycles, coarse=True)


@dataclass(frozen=True)
class HiddenRig:
    """A design on the virtual rig of a seed."""

    design_file: Path
    seed: int
    folder: Path
    """Folder of the rig file and of everything that is driven."""
    current_a: float = CURRENT_LIMIT_A
    measured: bool = True
    """Whether current and air are measured if the current is another one than the template's."""

    @cached_property
    def design(self) -> Design:
        """The robot."""
        return Design.load(self.design_file)

    @cached_property
    def rig_file(self) -> Path:
        """The rig file, written at the first call."""
        self.folder.mkdir(parents=True, exist_ok=True)
        text = virtual_rig(self.seed, str(self.design_file), physics="mujoco")
        seed = f"  seed: {self.seed}\n"
        text = text.replace(seed, f"{seed}  parameter_spread: large\n")
        if self.current_a != CURRENT_LIMIT_A:
            text = text.replace(
                f"current_limit_a: {CURRENT_LIMIT_A:g}", f"current_limit_a: {self.current_a:g}"
            )
        if self.measured and self.current_a != CURRENT_LIMIT_A:
            text = text.replace(_ASSUMED, _MEASURED)
        write_text(self.folder / "rig.yaml", text)
        return self.folder / "rig.yaml"

    @cached_property
    def rig(self) -> Rig:
        """The rig."""
        return Rig.load(self.rig_file)

    def drive(self, schedule: ActuationSchedule, log: Path) -> None:
        """Play a schedule and film it."""
        drive_rig(schedule, self.rig, self.rig_file, log, DriveConfig(self.design_file))

    @property
    def adapted(self) -> Path:
        """Folder of an adaptation."""
        return self.folder / "adapted"

    def adapt(self, config: AdaptationConfig, prior: Sequence[Path] = ()) -> Adaptation:
        """An adaptation there, or the one that was made."""
        return adapt(self.design_file, self.rig, self.adapted, self.drive, config, prior=prior)


class Rows:
    """Results in a file of JSON lines, a rig in each. Programs add lines to it side by side, and may be
    killed: a line that was not completed does not count."""

    def __init__(self, file: Path):
        file.parent.mkdir(parents=True, exist_ok=True)
        self._file = file

    def read(self) -> list[dict[str, Any]]:
        """All rows."""
        text = self._file.read_text() if self._file.exists() else ""
        return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("}\n")]

    def find(self, design_file: Path, seed: int) -> dict[str, Any] | None:
        """The row of a rig, if it is there."""
        key = str(design_file), seed
        return next((row for row in self.read() if (row["design"], row["seed"]) == key), None)

    def add(self, row: dict[str, Any]) -> None:
        """Append a row."""
        with self._file.open("a") as file:
            file.write(json.dumps(row) + "\n")
