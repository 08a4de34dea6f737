"""Tests have the markers of what they reach, through their fixtures and the functions of others."""

import pytest

from eldir_hardware.clock import VirtualClock
from tests.hardware.emulated_rigs import emulated, heating_program


@pytest.fixture
def driver():
    return heating_program


def given(request: pytest.FixtureRequest) -> set[str]:
    return {mark.name for mark in request.node.iter_markers()} & {"process", "realtime", "mujoco", "slow"}


def test_what_a_fixture_starts(request: pytest.FixtureRequest, driver: object) -> None:
    assert given(request) == {"process"}


def test_the_wall_clock_of_another_module(request: pytest.FixtureRequest) -> None:
    assert emulated is not None and given(request) == {"realtime"}


def test_a_virtual_clock(request: pytest.FixtureRequest) -> None:
    assert VirtualClock().now() == 0.0 and given(request) == set()


def test_real_time_lies_in_two_groups(request: pytest.FixtureRequest) -> None:
    """Of the tests that are run with this one, which is real-time itself."""
    assert emulated is not None
    groups = {True: set(), False: set()}
    for item in request.session.items:
        (group,) = item.iter_markers("xdist_group")
        groups[item.get_closest_marker("realtime") is not None] |= {*group.args}
    assert "realtime" in groups[True] <= {"realtime", "waiting"}
    assert not groups[True] & groups[False]
