"""A heated spring as its recording: the spring's hidden parameters, and noise."""

from dataclasses import replace

import numpy as np
import yaml

from eldir.built.heat import HeatModel
from eldir.parameters.springs import SpringParameters
from eldir_calibration.springs.recording import SpringRecording
from eldir_hardware.rig.configuration import Rig
from tests.hardware.rigs_and_schedules import rig_text

RATE = 4.0  # samples a second
FORMER = Rig.from_json(yaml.safe_load(rig_text())).spring_parameters()


def recorded(hidden: SpringParameters, noise: float = 0.3, seed: int = 0) -> SpringRecording:
    """Heated in still air to above Af and cooled, then again with the fan, as a user would record it."""
    rng, dt = np.random.default_rng(seed), 0.01
    plan = [(False, 7.0, 120.0), (True, 8.0, 60.0)]  # fan, heating and cooling [s]
    state, parts = None, []
    for fan, heating, cooling in plan:
        on = np.concatenate([np.ones(round(heating / dt)), np.zeros(round(cooling / dt))])
        history = HeatModel([replace(hidden, fan=fan)]).run(on[:, None], dt, state)
        state = history.final
        parts.append((on, history.temperature[:, 0], history.length[:, 0], np.full(len(on), fan)))
    on, temperature, length, fan = (
        np.concatenate(p)[:: round(1 / RATE / dt)] for p in zip(*parts, strict=True)
    )
    current = hidden.current_limit * on
    voltage = current * hidden.resistance * (1 + 0.003 * rng.standard_normal(len(on)))
    return SpringRecording(
        np.arange(len(on)) / RATE + dt,
        current,
        voltage,
        temperature + noise * rng.standard_normal(len(on)),
        fan,
        length + 2e-4 * rng.standard_normal(len(on)),
    )
