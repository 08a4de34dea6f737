"""Every fault on every kind of board, twice, at random instants."""

import random

import pytest

from hardware.relay.registration import kinds
from tests.hardware.fault_matrix import FAULTS, drawn, strike

pytestmark = pytest.mark.stress


def test_everything_is_off_in_time(tmp_path):
    seed = random.SystemRandom().randrange(1 << 30)
    print(f"seed {seed}\n| board | fault | instant | off after | message |\n| --- | --- | --- | --- | --- |")
    outcomes = []
    for kind, fault, own_seed in drawn(2 * len(kinds()) * len(FAULTS), seed):
        outcomes.append(strike(tmp_path, kind, fault, own_seed))
        print(outcomes[-1], flush=True)
    worst = {f: max((o.off_after for o in outcomes if o.fault == f), default=0.0) for f in FAULTS}
    print("worst of each fault:", {f: round(t, 2) for f, t in worst.items()})
    wrong = [f"{o} {o.wrong}" for o in outcomes if o.wrong]
    assert len(outcomes) >= 200 and not wrong, "\n".join(wrong)
