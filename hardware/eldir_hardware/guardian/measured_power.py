"""The heat of the nominal springs by the measured currents, for the temperatures that a run shows and logs.

Limits never use it: they hold for the largest current of the tolerances, whatever a sensor shows (decisions
33 and 61).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eldir.core.records import FloatArray
from eldir_hardware.rig.configuration import Rig

_MIN_WEIGHT = 0.1  # of a measurement: the mean of the last ten to twenty, one or two seconds of heating


class MeasuredPower:
    """Power of the spring on each channel, relative to the nominal one, which follows the measured current.

    Mean of the measurements, then an exponential filter. A channel that has not been measured counts as
    nominal; so do all on a shared supply, where a current depends on what else heats.
    """

    def __init__(self, rig: Rig):
        self._column = {c.channel: i for i, c in enumerate(rig.channels)}
        self._nominal = float(rig.spring_parameters().current(0.0))
        self._tolerance = rig.tolerances.current
        self._is_used = rig.supply.outputs == "each"
        self._counts = np.zeros(len(rig.channels))
        self._ratios = np.ones(len(rig.channels))

    def update(self, currents: Mapping[int, float]) -> None:
        """Take the measured currents of channels that heat, by channel [A]."""
        if not self._is_used:
            return
        for channel, current in currents.items():
            column = self._column[channel]
            self._counts[column] += 1
            weight = max(1.0 / self._counts[column], _MIN_WEIGHT)
            self._ratios[column] += weight * (current / self._nominal - self._ratios[column])

    @property
    def factors(self) -> FloatArray:
        """Of each channel in the rig file's order, within the tolerance of the current."""
        low, high = 1.0 - self._tolerance, 1.0 + self._tolerance
        return np.asarray(np.clip(self._ratios, low, high) ** 2)


def describe_correction(rig: Rig) -> str:
    """Which temperatures follow measured currents, for the log; empty if none does."""
    if rig.sensor is None or rig.supply.outputs != "each":
        return ""
    measured = ", ".join(str(channel) for channel in sorted(rig.measured_channels))
    return (
        f"the temperatures follow the measured currents of channels {measured}, within "
        f"{100 * rig.tolerances.current:g} % of the rig file's; limits do not"
    )
