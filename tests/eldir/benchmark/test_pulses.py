"""Pulses that end by a measurement: the tables of decision 59."""

import numpy as np
import pytest

from benchmarks import measured_pulses, pulses
from benchmarks.pulses import CORNERS, TRANSFORMED, Pulses
from eldir.built.gait import Gait, free_lengths
from eldir.parameters.springs import SpringParameters


def test_a_measured_pulse_ends_when_the_spring_has_transformed_or_its_time_is_over() -> None:
    """And the spring of another channel goes on; the next pulse heats again."""
    rig = pulses.make_rig()
    springs = [pulses.springs_at(rig, CORNERS[name]) for name in ("all hot", "all cold")]
    planned = np.zeros((1200, 2), bool)
    planned[:120] = planned[600:720] = True
    found = pulses.heat_measured(planned, springs, TRANSFORMED)
    (hot, cold), martensite = found.current.T > 0, found.martensite
    assert (cold == planned[:, 1]).all()
    for begin in (0, 600):
        heated = int(hot[begin : begin + 600].sum())
        assert hot[begin : begin + heated].all() and heated < 110
        assert martensite[begin + heated - 1, 0] < TRANSFORMED <= martensite[begin + heated - 2, 0]


def test_timed_pulses_are_those_of_the_product() -> None:
    gait, springs = (
        Gait(30.0, np.array([0.0, 0.3]), np.array([0.2, 0.2])),
        SpringParameters(current_limit=3.6),
    )
    (mine,) = measured_pulses.free_lengths_measured(gait, [[springs] * 2], None, 1)
    product = free_lengths(gait, springs, 1)
    np.testing.assert_allclose(mine.lengths, product.lengths, atol=1e-6)
    assert (mine.first_cycle, mine.interval) == (product.first_cycle, product.interval)


def test_a_measurement_that_is_believed_allows_more_current_where_springs_stay_warm() -> None:
    """At 3.5 A a spring that gets every pulse of 6 s in 20 s begins too hot for a contact that welds."""
    timed, measured = Pulses(6, 20), Pulses(6, 20, TRANSFORMED)
    rig = pulses.make_rig(3.52)
    assert not pulses.is_allowed(timed, rig) and pulses.is_allowed_if_measured(measured, rig)
    assert not pulses.is_allowed_if_measured(measured, pulses.make_rig(3.7))


def test_parts_of_a_pulse_transform_a_spring_no_further_than_its_hottest_moment() -> None:
    spring = SpringParameters()
    assert pulses._martensite_at(52.5, spring) == pytest.approx(0.5)
    assert (pulses._martensite_at(40.0, spring), pulses._martensite_at(70.0, spring)) == (1.0, 0.0)
    one, two = (pulses._peak_of_parts(2.0, n, spring) for n in (1, 2))
    assert spring.ambient < one < two < spring.steady_temperature
