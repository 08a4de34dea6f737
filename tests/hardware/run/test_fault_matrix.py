"""A tenth of the fault matrix; `make stress` strikes the rest."""

import pytest

from tests.hardware.run.fault_matrix import drawn, strike


@pytest.mark.parametrize(("kind", "fault", "seed"), drawn(21, seed=17))
def test_everything_is_off_in_time(kind, fault, seed, tmp_path):
    outcome = strike(tmp_path, kind, fault, seed)
    print(f"\n{outcome}")
    assert not outcome.wrong
