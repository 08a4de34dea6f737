"""A body of one spring for a virtual rig, and an observer that remembers."""

import numpy as np

from eldir_hardware.virtual.rig import BodyFrame
from eldir_hardware.virtual.springs import STEP


class Piston:
    """A body of one spring, as long as the coils of the first motor in the mean."""

    springs = np.array([[0, 1]], dtype=np.int32)
    discs = None

    def __init__(self) -> None:
        self.positions = np.zeros((2, 2))

    def move(self, lengths: np.ndarray, interval: float) -> None:
        assert interval == STEP and lengths.shape[1:] == (2, 2)
        self.positions = np.array([[0.0, 0.0], [lengths[-1, 0].mean(), 0.0]])


class Notes:
    """An observer that remembers."""

    def __init__(self) -> None:
        self.relays: list[tuple[float, tuple[bool, ...]]] = []
        self.temperatures: list[tuple[float, tuple[float, ...]]] = []
        self.currents: list[tuple[float, tuple[float, ...], tuple[float, ...]]] = []
        self.frames: list[BodyFrame] = []
        self.events: list[tuple[float, str]] = []

    def on_relays(self, t: float, states: tuple[bool, ...]) -> None:
        self.relays.append((t, states))

    def on_temperatures(self, t: float, temperatures: tuple[float, ...]) -> None:
        self.temperatures.append((t, temperatures))

    def on_currents(self, t: float, currents: tuple[float, ...], voltages: tuple[float, ...]) -> None:
        self.currents.append((t, currents, voltages))

    def on_event(self, t: float, text: str) -> None:
        self.events.append((t, text))
