"""What a schedule may hold, to the last value that is allowed, and what follows from it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from eldir.errors import InputError
from eldir_hardware.schedule import ActuationSchedule, Event, Pulse

EVENTS = (
    Event(0.0, 0, "front", 1, True),
    Event(0.0, 0, "back", 2, True),
    Event(2.0, 0, "front", 1, False),
    Event(3.0, 0, "back", 2, False),
)
EVENTS = tuple(sorted(EVENTS))
SCHEDULE = ActuationSchedule(10.0, events=EVENTS, cycles=3, conditioning_cycles=2, settle_s=4.0, springs=(7,))


def event(**changes: object) -> tuple[Event, ...]:
    """One pulse of one channel, with its first event changed."""
    return replace(EVENTS_OF_ONE[0], **changes), EVENTS_OF_ONE[1]


EVENTS_OF_ONE = (Event(1.0, 0, "front", 1, True), Event(2.0, 0, "front", 1, False))


@pytest.mark.parametrize(
    ("name", "allowed", "refused", "told"),
    [
        ("period_s", [3.0001, 120.0], [0.0, 0.099, -1.0, 120.1, float("inf"), float("nan")], "period_s"),
        ("cycles", [1, 100_000], [0, -1, 100_001], "cycles"),
        ("conditioning_cycles", [0, 100], [-1, 101], "conditioning_cycles"),
        ("settle_s", [0.0, 600.0], [-0.1, 600.1, float("nan")], "settle_s"),
    ],
)
def test_the_range_of_every_value(name, allowed, refused, told):
    for value in allowed:
        assert getattr(replace(SCHEDULE, **{name: value}), name) == value
    for value in refused:
        with pytest.raises(InputError, match=rf"invalid ActuationSchedule\.{told}"):
            replace(SCHEDULE, **{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("t_s", -0.1),
        ("spring", -1),
        ("spring", 64),
        ("channel", 0),
        ("channel", 65),
        ("face", "left"),
        ("face", ""),
    ],
)
def test_values_of_an_event_that_are_refused(name, value):
    with pytest.raises(InputError, match=rf"invalid Event\.{name}"):
        event(**{name: value})


@pytest.mark.parametrize(
    ("events", "told"),
    [
        ((EVENTS_OF_ONE[0], replace(EVENTS_OF_ONE[1], t_s=10.0)), "events.t_s"),
        (EVENTS_OF_ONE[::-1], "events"),
        (EVENTS_OF_ONE[:1], "channel 1"),
        (EVENTS_OF_ONE[1:], "channel 1"),
        ((EVENTS_OF_ONE[0], replace(EVENTS_OF_ONE[1], on=True)), "channel 1"),
        ((replace(EVENTS_OF_ONE[0], on=False), EVENTS_OF_ONE[1]), "channel 1"),
        ((EVENTS_OF_ONE[0], replace(EVENTS_OF_ONE[0], on=True, spring=1)), "channel 1"),
        ((replace(EVENTS_OF_ONE[0], on=False), EVENTS_OF_ONE[0]), "channel 1"),  # at one instant
        (
            (
                EVENTS_OF_ONE[0],
                EVENTS_OF_ONE[1],
                replace(EVENTS_OF_ONE[1], t_s=3.0),
                replace(EVENTS_OF_ONE[0], t_s=4.0),
            ),
            "channel 1",
        ),
    ],
)
def test_events_that_are_refused(events, told):
    with pytest.raises(InputError, match=f"ActuationSchedule: .*{told}"):
        ActuationSchedule(10.0, events=events)


def test_the_shortest_period():
    assert ActuationSchedule(0.1, events=()).period_s == 0.1
    with pytest.raises(InputError, match=r"invalid ActuationSchedule\.period_s; .* 0\.1"):
        ActuationSchedule(0.0999, events=())


def test_events_that_are_allowed():
    """At the period's start and end, on channel 1, on both faces, none at all, and one that ends first."""
    for events in (
        event(t_s=0.0),
        (EVENTS_OF_ONE[0], replace(EVENTS_OF_ONE[1], t_s=9.999)),
        event(face="back"),
        (),
        (replace(EVENTS_OF_ONE[0], on=False), replace(EVENTS_OF_ONE[1], on=True)),
    ):
        assert ActuationSchedule(10.0, events=events).events == tuple(events)


def test_what_is_meant_without_saying_so():
    schedule = ActuationSchedule(10.0, events=EVENTS)
    assert (schedule.cycles, schedule.conditioning_cycles, schedule.settle_s) == (5, 1, 3.0)
    assert schedule.springs == () and schedule.predicted.walk is None


def test_times_of_a_run():
    assert SCHEDULE.start_of_cycles == 24.0 and SCHEDULE.duration == 54.0
    assert [SCHEDULE.cycle_at(t) for t in (0, 23.9, 24.0, 33.9, 34.0, 53.9, 54.0, 99.0)] == [
        0, 0, 1, 1, 2, 3, 3, 3,
    ]  # fmt: skip
    assert SCHEDULE.channels == (1, 2)


def test_pulses_also_over_the_end_of_a_period():
    assert SCHEDULE.pulses() == [Pulse(1, 0.0, 2.0), Pulse(2, 0.0, 3.0)]
    over = ActuationSchedule(
        10.0, events=(replace(EVENTS_OF_ONE[0], on=False), replace(EVENTS_OF_ONE[1], on=True))
    )
    assert over.pulses() == [Pulse(1, 2.0, 9.0)]
    two = ActuationSchedule(
        10.0, events=(*EVENTS_OF_ONE, *(replace(e, t_s=e.t_s + 4.5) for e in EVENTS_OF_ONE))
    )
    assert two.pulses() == [Pulse(1, 1.0, 1.0), Pulse(1, 5.5, 1.0)]


def test_every_switching_of_a_run():
    found = list(SCHEDULE.switchings())
    assert len(found) == 5 * 3
    assert found[:4] == [
        (4.0, {1: True, 2: True}),
        (6.0, {1: False}),
        (7.0, {2: False}),
        (14.0, {1: True, 2: True}),
    ]
    assert found[-1] == (47.0, {2: False})


def test_states_of_a_run():
    channels, states = SCHEDULE.sampled(0.5)
    assert channels == (1, 2) and states.shape == (108, 2) and states.dtype == bool
    assert np.flatnonzero(states[:28, 0]).tolist() == [8, 9, 10, 11]
    assert np.flatnonzero(states[:28, 1]).tolist() == [8, 9, 10, 11, 12, 13]
    assert states.sum(axis=0).tolist() == [5 * 4, 5 * 6]
    _, coarse = SCHEDULE.sampled(1.0)
    assert np.flatnonzero(coarse[:10, 0]).tolist() == [4, 5]
    uneven = replace(SCHEDULE, settle_s=4.2).sampled(0.5)[1]
    assert np.flatnonzero(uneven[:16, 0]).tolist() == [8, 9, 10, 11], "the nearest step"


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("cycles", 2.0),
        ("cycles", True),
        ("cycles", "2"),
        ("conditioning_cycles", 1.5),
        ("springs", [1.0]),
        ("springs", [False]),
        ("events.spring", 0.5),
        ("events.channel", True),
        ("events.on", 1),
        ("events.on", "false"),
        ("events.on", None),
        ("events.off", True),
        ("more", 1),
    ],
)
def test_values_of_a_wrong_kind_are_refused(place, value):
    values = SCHEDULE.to_json()
    above, _, name = place.rpartition(".")
    (values["events"][0] if above else values)[name] = value
    with pytest.raises(InputError, match=name):
        ActuationSchedule.from_json(values)


@pytest.mark.parametrize("name", sorted(SCHEDULE.to_json().keys() - {"format"}))
def test_a_file_without_an_entry_is_refused(name):
    """A default stands for what a program leaves out, not for what a file lacks."""
    values = SCHEDULE.to_json()
    del values[name]
    with pytest.raises(InputError, match=name):
        ActuationSchedule.from_json(values)


def test_a_file_holds_every_value(tmp_path):
    path = tmp_path / "schedule.json"
    SCHEDULE.save(path)
    assert ActuationSchedule.load(path) == SCHEDULE
    text = path.read_text()
    assert text.endswith("}\n") and "\n " in text, "for people to read"
    values = json.loads(text)
    assert list(values) == [
        "format", "period_s", "cycles", "conditioning_cycles", "settle_s", "springs", "events", "predicted",
        "provenance",
    ]  # fmt: skip
    assert values["format"] == "eldir-schedule/1" and values["springs"] == [7]
    assert values["events"][0] == {"t_s": 0.0, "spring": 0, "face": "back", "channel": 2, "on": True}
