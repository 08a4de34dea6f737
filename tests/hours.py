"""A schedule in virtual time for hours, camera off."""

import gc
import time

import numpy as np
import pytest

from hardware.compiler import compile_schedule
from hardware.guardian.keeper import Keeper
from hardware.player import Player
from hardware.virtual.rig import VirtualRig

from .test_schedule import gait, rig_with
from .test_virtual_rig import Piston


class Watch:
    """Remembers little, however long it looks."""

    def __init__(self) -> None:
        self.reports = 0
        self.peaks: dict[int, float] = {}
        self.objects: list[int] = []

    def on_relays(self, t: float, states: tuple[bool, ...]) -> None:
        self.reports += 1
        if self.reports % 20_000 == 0:
            gc.collect()
            self.objects.append(len(gc.get_objects()))

    def on_temperatures(self, t: float, temperatures: tuple[float, ...]) -> None:
        hour = int(t // 600)
        self.peaks[hour] = max(self.peaks.get(hour, 0.0), *temperatures)

    def on_event(self, t: float, text: str) -> None:
        raise AssertionError(text)


def hours_of_a_schedule(hours: float, truth: bool = False) -> float:
    """Play it, judge it, and return how many times faster than real time it went.

    `truth`: heat the virtual springs too, and not only the guardian's model of them.
    """
    rig, watch = rig_with(), Watch()
    schedule = compile_schedule(gait(), rig, cycles=round(180 * hours))
    begun = time.monotonic()
    with VirtualRig(rig, Piston()) as virtual:
        player = Player(Keeper(virtual.board, rig, virtual.clock), schedule, rig, virtual.clock, [watch])
        start = virtual.clock.now() + 1.0
        rise, seen = [], virtual.emulator.edges

        def tidy(t: float) -> None:  # the emulator's list is the test's, not the rig's
            if truth:
                virtual.frame(t)
            rise.extend((e.t - start - schedule.settle_s) % schedule.period_s for e in seen if e.closed)
            seen.clear()
            virtual.clock.at(t + 60.0, tidy)

        virtual.clock.at(start + 30.0, tidy)
        played = player.play(start)
        assert not any(virtual.emulator.contacts) and virtual.springs.peak < 90.0
    assert played.duration_s == pytest.approx(schedule.duration, abs=0.5)
    phases = np.array(rise)
    assert np.minimum(phases % 10.0, 10.0 - phases % 10.0).max() < 0.03, "no drift"
    settled = [p for hour, p in watch.peaks.items() if hour > 0]
    assert max(settled) < 90.0 and np.ptp(settled) < 0.5
    assert not watch.objects or max(watch.objects) < 1.05 * watch.objects[0], "no leak"
    return schedule.duration / (time.monotonic() - begun)
