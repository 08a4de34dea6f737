"""Random pulse trains through pulse controller, driver and pseudo-terminal, judged by the contacts."""

from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np

from eldir.errors import EldirError
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.safety.limits import TIMER_STEP
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston

KINDS = (
    {"kind": "lcus"},
    {"kind": "modbus", "retriggerable": True},
    {"kind": "numato"},
    {"kind": "mosfet"},
)
CONTACT = 0.03  # wire and contact time, on one edge more than on the other [s]


class Train(NamedTuple):
    """How orders at random went."""

    ended: str
    """`played`, or the error's name."""
    too_long: float
    """A contact's longest time closed, beyond the longest allowed; minus infinity if none closed [s]."""
    hottest: float
    """Of the virtual springs [C]."""


def play_random_train(seed: int) -> Train:
    """Orders at random, sound ones and others; raises where a limit was broken."""
    rng = np.random.default_rng(seed)
    longest, rest, budget = rng.uniform(0.5, 6.0), rng.uniform(0.3, 8.0), 4.0 * rng.integers(1, 5)
    rig = rig_with(
        board=KINDS[int(rng.integers(len(KINDS)))],
        limits={"max_on_s": float(longest), "min_off_s": float(rest)},
        supply={"max_total_current_a": float(budget)},
    )
    ended = "played"
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        silent = rng.random() < 0.2  # whoever orders falls silent after the last order
        try:
            with bank.armed():
                for _ in range(int(rng.integers(1, 7))):
                    at = virtual.clock.now() + float(rng.uniform(0.05, 1.0))
                    chosen = rng.choice([1, 2, 3, 4], size=int(rng.integers(1, 4)), replace=False)
                    bank.heat(at, {int(c): float(rng.uniform(0.05, 1.05 * longest)) for c in chosen})
                    bank.wait_until(at + float(rng.uniform(0.8, 1.5) * (longest + rest)))
                    if rng.random() < 0.1:
                        bank.abort_pulses()
                until = virtual.clock.now() + 2.0
                while silent and virtual.clock.now() < until:
                    virtual.clock.sleep_until(min(bank.step(), virtual.clock.now() + 0.1))
                assert not silent, "heat without a heartbeat"
        except EldirError as error:
            ended = type(error).__name__
        virtual.clock.sleep_until(virtual.clock.now() + 2.0)
        virtual.frame(virtual.clock.now())
        assert not any(virtual.emulator.contacts)
        assert virtual.springs.max_temperature_c < 90.0
        too_long = _judge(virtual.emulator.contact_events, longest, rest, round(budget / 4.0))
    return Train(ended, too_long, virtual.springs.max_temperature_c)


def _judge(edges, longest: float, rest: float, together: int) -> float:
    most = -np.inf
    by_channel = sorted(edges, key=lambda e: (e.channel, e.t))
    for _, group in groupby(by_channel, key=lambda e: e.channel):
        times = [(e.t, e.closed) for e in group]
        assert [closed for _, closed in times] == [True, False] * (len(times) // 2)
        for (a, closed), (b, _) in pairwise(times):
            if closed:
                most = max(most, b - a - longest)
                assert most <= TIMER_STEP + CONTACT, f"on for {b - a:.3f} s"
            else:
                assert b - a >= rest - TIMER_STEP - CONTACT, f"off for {b - a:.3f} s only"
    closed = 0
    for edge in sorted(edges, key=lambda e: (e.t, e.closed)):
        closed += 1 if edge.closed else -1
        assert closed <= together, "more than the supply gives"
    return most
