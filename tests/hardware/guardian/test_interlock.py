"""What the interlock refuses, value by value; temperatures are in test_interlock_heat.py."""

import pytest

from eldir_hardware.guardian._forecast import HeatingInterval
from eldir_hardware.guardian._interlock import Interlock
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.limits import LimitError
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

WEAK = {"current_limit_a": 1.5, "max_total_current_a": 3.15}
"""So little current that no temperature forbids anything; two springs at once, with 5 % more each."""


def weak(**limits: float) -> Rig:
    return rig_with(supply=WEAK, limits=limits)


def until(ends: dict[int, float]) -> list[HeatingInterval]:
    """What is closed or announced: for the second before the end of each channel."""
    return [HeatingInterval(end - 1.0, channel, end) for channel, end in ends.items()]


def pulses(watch: Interlock, channel: int, *spans: tuple[float, float]) -> None:
    """The channel was closed and opened at these times."""
    for closed, opened in spans:
        watch.record_switching({channel: True}, closed)
        watch.record_switching({channel: False}, opened)


@pytest.mark.parametrize("channel", [0, 5, -1])
def test_a_channel_that_heats_no_spring(channel):
    with raises(LimitError, "limit.other-wiring", match=r"one of \[1, 2, 3, 4\]"):
        Interlock(weak(), 0.0).check_pulses(1.0, {1: 1.0, channel: 1.0})


@pytest.mark.parametrize(
    ("seconds", "allowed"),
    [
        (6.0, True),
        (6.0 + 1e-9, True),
        (6.0 + 1e-6, True),
        (0.01, True),
        (6.01, False),
        (0.0, False),
        (-1.0, False),
        (float("nan"), False),
    ],
)
def test_how_long_a_pulse_may_be(seconds, allowed):
    watch = Interlock(weak(), 0.0)
    if allowed:
        watch.check_pulses(1.0, {2: seconds})
    else:
        with raises(LimitError, "limit.long-pulse", match="channel 2 .*at most 6 s"):
            watch.check_pulses(1.0, {1: 1.0, 2: seconds})


@pytest.mark.parametrize(("longest", "most"), [(6.0, 6.0), (6.3, 6.3), (8.0, 6.3)])
def test_a_pulse_ends_before_the_cutoff_acts(longest, most):
    """Otherwise the cut-off would open in normal use, and its failure would not be noticed."""
    watch = Interlock(weak(max_on_s=longest, duty=1.0), 0.0)
    watch.check_pulses(1.0, {1: most})
    with raises(LimitError, "limit.long-pulse", match=f"at most {most:g} s"):
        watch.check_pulses(1.0, {1: most + 0.01})


@pytest.mark.parametrize(
    ("opened", "announced", "at", "allowed"),
    [
        (10.0, {}, 17.96, True),  # contacts do not move to the millisecond
        (10.0, {}, 17.94, False),
        (None, {1: 10.0}, 17.96, True),
        (None, {1: 10.0}, 17.94, False),
        (10.0, {1: 14.0}, 21.94, False),  # the later one counts
        (10.0, {1: 14.0}, 21.96, True),
        (14.0, {1: 10.0}, 21.94, False),
        (10.0, {2: 14.0}, 18.0, True),  # of this channel
        (None, {}, 1.0, True),
        (None, {1: 20.0}, 19.0, False),  # while the announced pulse still lasts
        (None, {1: 40.0}, 30.04, True),  # and before it: from 31.04 to 39
        (None, {1: 40.0}, 30.06, False),
    ],
)
def test_rest_after_what_heated_and_after_what_is_announced(opened, announced, at, allowed):
    watch = Interlock(weak(), 0.0)
    if opened is not None:
        pulses(watch, 1, (opened - 1.0, opened))
    if allowed:
        watch.check_pulses(at, {1: 1.0}, until(announced))
    else:
        with raises(LimitError, "limit.no-rest", match="channel 1 .*at least 8 s"):
            watch.check_pulses(at, {3: 1.0, 1: 1.0}, until(announced))


@pytest.mark.parametrize(
    ("spans", "seconds", "allowed"),
    [
        ([], 6.0, True),
        ([(0.0, 6.0), (15.0, 21.0), (30.0, 34.0)], 5.0, True),  # 21 of 60 s
        ([(0.0, 6.0), (15.0, 21.0), (30.0, 34.0)], 5.1, False),
        ([(0.0, 6.0), (15.0, 21.0), (30.0, 36.0)], 3.0, True),
        ([(0.0, 6.0), (15.0, 21.0), (30.0, 36.0)], 3.1, False),
    ],
)
def test_duty_of_a_minute(spans, seconds, allowed):
    """The minute begins or ends with any pulse, here with the one that is asked for, at 45 s."""
    watch = Interlock(weak(duty=0.35), 0.0)
    pulses(watch, 1, *spans)
    pulses(watch, 2, (0.0, 6.0), (15.0, 21.0))
    if allowed:
        watch.check_pulses(45.0, {1: seconds})
    else:
        with raises(LimitError, "limit.duty", match="channel 1 .*at most 0.35 of any 60 s"):
            watch.check_pulses(45.0, {1: seconds})


@pytest.mark.parametrize(("seconds", "allowed"), [(4.9, True), (5.2, False)])
def test_a_pulse_leaves_the_minute_bit_by_bit(seconds, allowed):
    """At 60 s a pulse of 5 s from 0 to 5 s: as long as the new one is, so much of it has left."""
    watch = Interlock(weak(duty=0.25), 0.0)
    pulses(watch, 1, (0.0, 5.0), (20.0, 25.0), (40.0, 45.0))
    if allowed:  # 15 s: what is left of the first, two pulses of 5 s, and the new one
        watch.check_pulses(60.0, {1: seconds})
    else:
        with raises(LimitError, "limit.duty"):
            watch.check_pulses(60.0, {1: seconds})


def test_a_pulse_that_is_longer_than_the_duty_of_a_minute_is_refused_alone_too():
    """As in a schedule: the duty is a part of any minute."""
    watch = Interlock(weak(duty=0.05), 0.0)
    watch.check_pulses(1.0, {1: 3.04})
    with raises(LimitError, "limit.duty", match="at most 0.05 of any 60 s; found 3.1 s"):
        watch.check_pulses(1.0, {1: 3.06})
    pulses(watch, 1, (1.0, 3.0))
    with raises(LimitError, "limit.duty"):
        watch.check_pulses(12.0, {1: 1.1})
    watch.check_pulses(12.0, {1: 1.0})


def test_what_heats_now_counts_for_the_duty():
    watch = Interlock(weak(duty=0.35, min_off_s=0.05), 0.0)
    pulses(watch, 1, (0.0, 6.0), (10.0, 16.0))
    watch.record_switching({1: True}, 20.0)
    watch.record_switching({1: True}, 23.0)  # a command that is repeated begins nothing
    closed = [HeatingInterval(20.0, 1, 25.0)]
    watch.check_pulses(25.1, {1: 3.9}, closed)
    with raises(LimitError, "limit.duty"):
        watch.check_pulses(25.1, {1: 4.2}, closed)
    watch.record_switching({1: False}, 25.0)
    watch.check_pulses(25.1, {1: 3.9})
    with raises(LimitError, "limit.duty"):
        watch.check_pulses(25.1, {1: 4.2})


@pytest.mark.parametrize(
    ("lengths", "announced", "allowed"),
    [
        ({1: 1.0, 2: 1.0}, {}, True),
        ({1: 1.0, 2: 1.0, 3: 1.0}, {}, False),
        ({1: 1.0}, {2: 20.1, 3: 20.1}, False),
        ({1: 1.0}, {2: 20.1, 3: 20.04}, True),  # as good as open
        ({1: 1.0, 2: 1.0}, {3: 20.1}, False),
        ({1: 1.0}, {2: 20.1}, True),
    ],
)
def test_current_together_with_what_already_heats(lengths, announced, allowed):
    watch = Interlock(weak(), 0.0)
    if allowed:
        watch.check_pulses(20.0, lengths, until(announced))
    else:
        with raises(LimitError, "limit.supply"):
            watch.check_pulses(20.0, lengths, until(announced))


def test_only_springs_take_current():
    """A fan or a contactor is no spring."""
    watch = Interlock(weak(), 0.0)
    watch.check_together({1, 2, 7, 8})
    with raises(LimitError, "limit.supply", match="at most 3.15 A; found 3 x 1.58 A"):
        watch.check_together({1, 2, 3})


@pytest.mark.parametrize(("closed", "stops"), [(6.09, False), (6.11, True)])
def test_how_long_a_channel_may_stay_closed(closed, stops):
    """From the first command that closed it; one step of a board's timer more than the longest pulse."""
    watch = Interlock(weak(), 100.0)
    watch.record_switching({2: True, 7: True}, 100.0)
    watch.record_switching({2: True}, 103.0)
    if stops:
        with raises(LimitError, "limit.long-pulse", match="channel 2 .*at most 6 s"):
            watch.check(100.0 + closed)
    else:
        watch.check(100.0 + closed)
        watch.record_switching({2: False}, 106.0)
        watch.check(200.0)


def test_a_rig_that_must_not_heat():
    with raises(LimitError, "limit.stuck-contact"):
        Interlock(rig_with(cutoff=None), 0.0)


def test_a_rest_that_is_longer_than_the_minute_of_the_duty():
    watch = Interlock(weak(min_off_s=100.0), 0.0)
    pulses(watch, 1, (9.0, 10.0))
    pulses(watch, 2, (71.0, 72.0))  # what was spent before is forgotten now
    with raises(LimitError, "limit.no-rest", match=r"channel 1 .*found 99\.90 s"):
        watch.check_pulses(109.9, {1: 1.0})
    watch.check_pulses(110.0, {1: 1.0})


def test_how_many_pulses_and_how_far_ahead():
    """32 pulses together with those that are asked for; the end of each within 60 s."""
    watch = Interlock(weak(), 0.0)
    announced = [HeatingInterval(10.0 + 0.5 * k, 2, 10.1 + 0.5 * k) for k in range(32)]
    watch.check_pulses(1.0, {1: 1.0}, announced[:31])
    with raises(LimitError, "limit.announced", match="at most 32; found 33"):
        watch.check_pulses(1.0, {1: 1.0}, announced)
    watch.check_pulses(59.0, {1: 1.0})
    with raises(LimitError, "limit.announced", match="channel 1 .*within 60 s"):
        watch.check_pulses(59.1, {1: 1.0})
