"""Long proofs of the rig: noise into every parser, an hour of a schedule, edges on the wall clock."""

from collections import Counter

import numpy as np
import pytest

from eldir_calibration.identification.spring_record import load_spring_recording
from eldir_calibration.springs.fit import fit_spring
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.rig.devices import get_driver
from tests.calibration.springs.spring_recordings import FORMER, recorded
from tests.calibration.springs.spring_tables import Truth, write
from tests.calibration.springs.spring_tables import measure as measure_spring
from tests.hardware.guardian.random_pulse_trains import play_random_train
from tests.hardware.planning.edge_times import PULSE, measure
from tests.hardware.relay.relay_answers import CHANCE, CHECKSUM, believed_wrongly
from tests.hardware.run.hours_of_a_schedule import hours_of_a_schedule

pytestmark = pytest.mark.stress


@pytest.mark.parametrize("kind", installed_kinds())
def test_a_million_mutated_answers(kind):
    """Nothing but the driver's own error, and no state that the board did not report."""
    assert believed_wrongly(kind, 1_000_000) <= CHANCE.get(kind, CHECKSUM)


def test_a_hundred_hours_of_a_schedule():
    print(hours_of_a_schedule(100, truth=True))


def test_ten_thousand_random_pulse_trains():
    trains = [play_random_train(seed) for seed in range(1000, 11_000)]
    ended = Counter(t.ended for t in trains)
    print(ended, "longest beyond what is allowed:", max(t.too_long for t in trains), "s")
    print("hottest:", max(t.hottest for t in trains), "C")
    assert {"played", "LimitError", "KeepaliveError"} <= set(ended)


@pytest.mark.parametrize("kind", installed_kinds())
def test_edges_on_the_wall_clock(kind):
    """Edges within 20 ms at the 99th percentile, pulses within 2 % of their heat."""
    found = measure(kind)
    print(f"{kind}: {found}")
    assert np.quantile(abs(found.late), 0.99) < 0.020
    assert np.quantile(abs(found.heat - 1), 0.99) < 0.02 + get_driver(kind).closing_interval / 2 / PULSE


def test_intervals_hold_what_they_promise():
    """Of eight recordings' intervals at 95 %, nearly all hold the truth."""
    hidden = FORMER.perturb(np.random.default_rng(4))
    names = ("heat_capacity", "convection_still", "convection_fan", "austenite_start", "martensite_finish")
    held = []
    for seed in range(8):
        found = fit_spring(recorded(hidden, seed=100 + seed), FORMER).estimates
        held += [abs(found[n].value - getattr(hidden, n)) < found[n].margin for n in names]
    assert np.mean(held) > 0.8, "0.95 expected of 40"


@pytest.mark.parametrize("warming", [0.0, 4.0])
def test_intervals_hold_the_truth_of_another_integration(tmp_path, warming):
    """Twenty tables by a model that is not ours: of the intervals at 95 %, nearly all hold the truth."""
    truth = Truth(warming=warming)
    names = ("heat_capacity", "latent_heat", "convection_still", "convection_fan", "resistance",
             "austenite_start", "austenite_finish", "martensite_start", "martensite_finish",
             "cold_length", "hot_length")  # fmt: skip
    held = []
    for seed in range(20):
        table = measure_spring(truth, 50 + seed)
        del table["ambient_c"]
        found = fit_spring(load_spring_recording(write(tmp_path / "table.csv", table)), FORMER).estimates
        held.append([abs(found[n].value - getattr(truth, n)) < found[n].margin for n in names])
    print(dict(zip(names, np.mean(held, axis=0).tolist(), strict=True)))
    assert np.mean(held) > 0.9 and np.mean(held, axis=0).min() >= 0.75
