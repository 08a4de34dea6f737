"""Pulse controllers on virtual rigs, shared by their tests."""

from collections.abc import Iterator
from contextlib import contextmanager

from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.pulse_controller import Host, PulseController
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston

FAN = {"fan": {"interlocked": True, "channel": 5}}


def rig_of(kind: str = "lcus", cutoff: dict | None = None, **changes: object) -> Rig:
    """A rig with room for a fan or a contactor on channel 5."""
    board = {"kind": kind, "channels": 5} | ({"retriggerable": True} if kind == "modbus" else {})
    values = rig_with(board=board).model_dump() | changes
    return Rig.from_json(values | ({"cutoff": cutoff} if cutoff else {}))


@contextmanager
def controlled(rig: Rig, slept=lambda: 0.0) -> Iterator[tuple[VirtualRig, PulseController, list[Report]]]:
    seen: list[Report] = []
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock, host=Host(slept))
        bank.on_report = seen.append
        yield virtual, bank, seen


def edges(virtual: VirtualRig, channel: int) -> list[tuple[float, bool]]:
    return [(e.t, e.closed) for e in virtual.emulator.contact_events if e.channel == channel]


def step_until(virtual: VirtualRig, bank: PulseController, t: float) -> None:
    """As the guardian does, without a heartbeat."""
    while virtual.clock.now() < t:
        virtual.clock.sleep_until(min(bank.step(), t))
