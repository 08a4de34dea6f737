"""The body on the virtual rig: the engine's built robot with deviations from the nominal parameters."""

from __future__ import annotations

import numpy as np

from eldir.built.motion import FINE, drive
from eldir.built.robot import build
from eldir.core.records import FloatArray
from eldir.errors import blown_up
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters


class BuiltBody:
    """One plane of the robot on the table, simulated step by step."""

    def __init__(
        self,
        morphology: Morphology,
        seed: int,
        springs: SpringParameters,
        ballast: float | FloatArray = 0.0,
        built: BuiltParameters | None = None,
    ):
        """`ballast` [kg] of this plane, as in `build`; `built`: parameters of the robot, else by `seed`."""
        rng = np.random.default_rng([seed, 2])
        own = BuiltParameters().perturbed(rng) if built is None else built
        self._robot = build(morphology, own, ballast=ballast, rng=rng)
        self._free = (springs.cold_length, springs.hot_length)
        self._lengths = np.full((1, morphology.motors), springs.cold_length)
        self._state: FloatArray | None = None
        self.remark = ""  # it knows no parts
        self.springs = morphology.springs
        self.positions = self._robot.positions

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Follow free lengths given every `interval` [s], shape (steps, motors)."""
        table = np.concatenate([self._lengths, lengths[:, : self._lengths.shape[1]]])
        states = None if self._state is None else [self._state]
        (motion,) = drive(
            [self._robot], [table], interval, states=states, every=len(lengths), free=self._free
        )
        if motion.status != FINE:
            raise blown_up("the virtual robot's body")
        self._state = motion.state
        self._lengths = table[-1:]
        self.positions = motion.positions[-1]
