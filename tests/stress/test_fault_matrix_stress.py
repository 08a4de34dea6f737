"""Every fault on every kind of board, twice, at random instants."""

import random
from collections import deque

import pytest

from eldir_hardware.relay.registration import installed_kinds
from tests.hardware.run.fault_matrix import NeverHeatedError, drawn, strike
from tests.hardware.run.faults import FAULTS

pytestmark = pytest.mark.stress
_BUSY = 20
"""So many strikes are put off to the end where heating did not begin."""


def test_everything_is_off_in_time(tmp_path):
    seed = random.SystemRandom().randrange(1 << 30)
    print(f"seed {seed}\n| board | fault | instant | off after | message |\n| --- | --- | --- | --- | --- |")
    outcomes = []
    left = deque(drawn(2 * len(installed_kinds()) * len(FAULTS), seed))
    never = 0
    while left:
        kind, fault, own_seed = left.popleft()
        try:
            outcomes.append(strike(tmp_path, kind, fault, own_seed))
            print(outcomes[-1], flush=True)
        except NeverHeatedError as e:
            never += 1  # nothing about safety: the machine was too busy for a run
            assert never <= _BUSY, f"{never} strikes could not begin: let the machine rest ({e})"
            left.append((kind, fault, own_seed + 1))
    worst = {f: max((o.off_after for o in outcomes if o.fault == f), default=0.0) for f in FAULTS}
    print("worst of each fault:", {f: round(t, 2) for f, t in worst.items()})
    told = {f: max((o.told_after for o in outcomes if o.fault == f), default=0.0) for f in FAULTS}
    print("longest until it is told:", {f: round(t, 2) for f, t in told.items() if FAULTS[f].says})
    wrong = [f"{o} {o.wrong}" for o in outcomes if o.wrong]
    assert len(outcomes) >= 200 and not wrong, "\n".join(wrong)
