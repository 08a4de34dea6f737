"""Long proofs of the rig: noise into every parser, an hour of a schedule, edges on the wall clock."""

from collections import Counter

import numpy as np
import pytest

from calibration.springs import fit_springs
from hardware.clock import WallClock
from hardware.compiler import compile_schedule
from hardware.emulator.boards import EMULATORS
from hardware.guardian.client import Guardian
from hardware.player import Player
from hardware.relay.drivers import DRIVERS

from ..hours import hours_of_a_schedule
from ..pulse_trains import play_random_train
from ..relay_answers import ANSWERS, believed_wrongly
from ..test_schedule import gait, rig_with
from ..test_springs_calibration import FORMER, recorded

pytestmark = pytest.mark.stress


@pytest.mark.parametrize("kind", sorted(DRIVERS))
def test_a_million_mutated_answers(kind):
    """Nothing but the driver's own error, and no state that the board did not report."""
    assert believed_wrongly(ANSWERS[kind], 1_000_000) <= ANSWERS[kind].chance


def test_a_hundred_hours_of_a_schedule():
    print(f"{hours_of_a_schedule(100, truth=True):.0f} times real time")


def test_ten_thousand_random_pulse_trains():
    ended = Counter(play_random_train(seed) for seed in range(1000, 11_000))
    print(ended)
    assert {"played", "LimitError", "HeartbeatError"} <= set(ended)


@pytest.mark.parametrize("kind", sorted(DRIVERS))
def test_edges_on_the_wall_clock(kind):
    """Edges within 20 ms at the 99th percentile, pulses within 2 % of their heat."""
    rig = rig_with(limits={"least_off_s": 0.3}, board={"kind": kind, "second_flash": "restarts"})
    schedule = compile_schedule(gait(duty=(0.25, 0.25), period=2.0, phase=(0.0, 0.4)), rig, cycles=14)
    clock = WallClock()
    emulated = EMULATORS[kind](4, clock)
    with Guardian(rig, emulated.start()) as bank:
        start = clock.now() + 1.0
        Player(bank, schedule, rig, clock).play(start)
    emulated.close()
    wanted = sorted((c, t, on) for t, changes in schedule.switchings() for c, on in changes.items())
    found = sorted((e.channel, e.t - start, e.closed) for e in emulated.edges)
    late = np.array([f[1] - w[1] for f, w in zip(found, wanted, strict=True)])
    off = np.quantile(np.abs(late), 0.99)
    print(f"{kind}: median {1e3 * np.median(late):.1f} ms late, 99 % within {1e3 * off:.1f} ms")
    assert off < 0.020
    lengths = np.array([b[1] - a[1] for a, b in zip(found[::2], found[1::2], strict=True)])
    print(f"pulses within {100 * abs(lengths / 0.5 - 1).max():.2f} % (0.5 s)")
    assert abs(lengths.mean() / 0.5 - 1) < 0.02


def test_intervals_hold_what_they_promise():
    """Of eight recordings' intervals at 95 %, nearly all hold the truth."""
    hidden = FORMER.perturbed(np.random.default_rng(4))
    names = ("heat_capacity", "convection_still", "convection_fan", "austenite_start", "martensite_finish")
    held = []
    for seed in range(8):
        found = fit_springs(recorded(hidden, seed=100 + seed), FORMER).estimates
        held += [abs(found[n].value - getattr(hidden, n)) < found[n].margin for n in names]
    assert np.mean(held) > 0.8, "0.95 expected of 40"
