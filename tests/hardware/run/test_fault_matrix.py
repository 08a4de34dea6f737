"""A few of the fault matrix: each board once, by what test_faults.py does not strike.

`make stress` strikes all.
"""

import pytest

from tests.hardware.run.fault_matrix import strike

STRUCK = [
    ("feedback", "rig off, player hangs"),
    ("gd32", "player hangs"),
    ("lcus", "SIGHUP"),
    ("modbus", "SIGKILL of both"),
    ("mosfet", "guardian hangs"),
    ("numato", "contact welded, not reported"),
    ("sainsmart", "moved link then SIGKILL of the guardian"),
]


@pytest.mark.parametrize(("seed", "kind", "fault"), [(i, *pair) for i, pair in enumerate(STRUCK)])
def test_everything_is_off_in_time(seed, kind, fault, tmp_path):
    outcome = strike(tmp_path, kind, fault, seed, cycles=1)
    print(f"\n{outcome}")
    assert not outcome.wrong
