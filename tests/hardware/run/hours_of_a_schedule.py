"""A schedule in virtual time for hours, camera off."""

import gc
import resource
import time
from pathlib import Path
from typing import NamedTuple

import pytest

from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.run.player import Player
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.rigs_and_schedules import gait, rig_with
from tests.hardware.virtual.piston_and_observer import Piston


class Hours(NamedTuple):
    """How they went."""

    faster: float
    """Than real time."""
    drift: float
    """Farthest of an edge from its place in the cycle [s]."""
    peaks: tuple[float, float]
    """Least and highest of the peaks of each ten minutes but the first, by the guardian's model [C]."""
    hottest: float
    """Of the virtual springs, where they were heated [C]."""
    objects: float
    """Python objects at most, over those after the first hours."""
    memory: float
    """Growth of the process [MB]."""


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
        ten_minutes = int(t // 600)
        self.peaks[ten_minutes] = max(self.peaks.get(ten_minutes, 0.0), *temperatures)

    def on_currents(self, t: float, currents: tuple[float, ...], voltages: tuple[float, ...]) -> None:
        raise AssertionError("no sensor")

    def on_event(self, t: float, text: str) -> None:
        raise AssertionError(text)


def hours_of_a_schedule(hours: float, truth: bool = False) -> Hours:
    """Play it and judge it.

    `truth`: heat the virtual springs too, and not only the guardian's model of them.
    """
    rig, watch = rig_with(), Watch()
    schedule = compile_schedule(gait(), rig, cycles=round(180 * hours))
    begun, drift, resident = time.monotonic(), 0.0, _resident()
    with VirtualRig(rig, Piston()) as virtual:
        player = Player(
            PulseController(virtual.board, rig, virtual.clock), schedule, rig, virtual.clock, [watch]
        )
        start = virtual.clock.now() + 1.0
        seen = virtual.emulator.contact_events

        def tidy(t: float) -> None:  # the emulator's list is the test's, not the rig's
            nonlocal drift, resident
            if truth:
                virtual.frame(t)
            for edge in seen:
                place = (edge.t - start - schedule.settle_s) % 10.0 - (0.0 if edge.closed else 5.5)
                drift = max(drift, abs((place + 5.0) % 10.0 - 5.0))
            seen.clear()
            if t < start + 600.0:
                resident = _resident()
            virtual.clock.call_at(t + 60.0, tidy)

        virtual.clock.call_at(start + 30.0, tidy)
        played = player.play(start)
        tidy(virtual.clock.now())
        assert not any(virtual.emulator.contacts)
    assert played.duration_s == pytest.approx(schedule.duration, abs=0.5)
    settled = [p for when, p in watch.peaks.items() if when > 0]
    found = Hours(
        schedule.duration / (time.monotonic() - begun),
        drift,
        (min(settled), max(settled)),
        virtual.springs.max_temperature_c,
        max(watch.objects, default=1) / (watch.objects or [1])[0],
        _resident() - resident,
    )
    assert found.drift < 0.005, "no drift"
    assert found.peaks[1] < 90.0 and found.hottest < 90.0 and found.peaks[1] - found.peaks[0] < 0.5
    assert found.objects < 1.05 and found.memory < 20.0, "no leak"
    return found


def _resident() -> float:
    """Memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6
