"""Schedules: files, what is refused before heat, and that nothing compiled ever breaks a limit."""

import json
import os
import re
from contextlib import suppress
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.built.heat import heat
from eldir.errors import EldirError, InputError
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import real_rig, virtual_rig
from eldir_hardware.safety import limits
from eldir_hardware.safety.compatibility import require_compatible, with_digests
from eldir_hardware.safety.limits import LimitError
from eldir_hardware.schedule import ActuationSchedule, Event, ScheduleProvenance
from tests.hardware.rigs_and_schedules import RIG, SCHEDULE, gait, rig_with
from tests.paths import SCHEMAS
from tests.raised import raises


def schema(name: str) -> dict:
    return json.loads((SCHEMAS / f"{name}.schema.json").read_text())


def test_a_schedule_survives_its_file(tmp_path):
    path = tmp_path / "schedule.json"
    SCHEDULE.save(path)
    assert ActuationSchedule.load(path) == SCHEDULE
    jsonschema.validate(json.loads(path.read_text()), schema("schedule"))
    first = path.read_bytes()
    compile_schedule(gait(), RIG, springs=(7, 12)).save(path)
    assert path.read_bytes() == first


def test_a_design_whose_name_is_no_text_is_named_in_the_file(tmp_path):
    """Not UTF-8: the virtual rig finds its robot, and the digest is that of the content."""
    name, path = os.fsdecode(b"caf\xe9.json"), tmp_path / "schedule.json"
    origin = ScheduleProvenance(design=name, seed=1, notes={"from": [{"log": name}]})
    schedule = with_digests(replace(SCHEDULE, provenance=origin, springs=(7, 12)), RIG)
    schedule.save(path)
    found = ActuationSchedule.load(path)
    assert found == schedule and found.provenance.design == name
    assert require_compatible(found, RIG, None) is None


def test_both_faces_are_heated_alike():
    for spring in (0, 1):
        front = [(e.t_s, e.on) for e in SCHEDULE.events if (e.spring, e.face) == (spring, "front")]
        back = [(e.t_s, e.on) for e in SCHEDULE.events if (e.spring, e.face) == (spring, "back")]
        assert front == back == [(10.0 * spring, True), (10.0 * spring + 5.5, False)]
    assert SCHEDULE.channels == (1, 2, 3, 4)
    assert SCHEDULE.duration == 3 + 6 * 20


def test_a_pulse_over_the_end_of_a_period():
    schedule = compile_schedule(gait(phase=(0.9, 0.4)), RIG)
    assert {round(p.length, 6) for p in schedule.pulses()} == {5.5}
    channels, states = schedule.sampled(0.01)
    column = states[:, channels.index(1)]
    assert not column[: round((3 + 18) / 0.01)].any(), "not before its first start"
    assert 0.01 * column.sum() == pytest.approx(5 * 5.5 + 2, abs=0.02), "cut at the end of the last cycle"


@pytest.mark.parametrize(
    ("change", "code", "key", "said"),
    [
        ({"events": SCHEDULE.events[::-1]}, "inconsistent", None, "order of time"),
        ({"events": SCHEDULE.events[1:]}, "inconsistent", None, "on and off in turn"),
        ({"period_s": 9.0}, "inconsistent", None, "within the period of 9 s"),
        ({"cycles": 0}, "wrong-value", "cycles", None),
        ({"events": SCHEDULE.events * 33}, "wrong-value", "events", None),
    ],
)
def test_an_unsound_schedule_is_refused(change, code, key, said):
    with raises(InputError, f"schedule.{code}", key, match=said):
        replace(SCHEDULE, **change)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "eldir-design/1"}'])
def test_a_damaged_file_is_named(tmp_path, text):
    path = tmp_path / "schedule.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"schedule\.json"):
        ActuationSchedule.load(path)


@settings(max_examples=30)
@given(st.data())
def test_a_changed_value_is_an_error_or_another_sound_schedule(tmp_path_factory, data):
    values = SCHEDULE.to_json()
    key = data.draw(st.sampled_from(sorted(values)))
    values[key] = data.draw(
        st.none() | st.booleans() | st.floats() | st.text(max_size=3) | st.lists(st.integers(), max_size=2)
    )
    path = tmp_path_factory.mktemp("schedule") / "schedule.json"
    path.write_text(json.dumps(values))
    with suppress(EldirError):
        assert ActuationSchedule.load(path).to_json().keys() == values.keys()


# Limits.


@pytest.mark.parametrize(
    ("rig", "code", "key", "said"),
    [
        (rig_with(supply={"current_limit_a": None}), "not-measured", "supply.current_limit_a", None),
        (rig_with(springs={"resistance_ohm": None}), "not-measured", "springs.resistance_ohm", None),
        (rig_with(cutoff=None), "stuck-contact", None, "expected at most 90 C; found [0-9]+ C"),
        (rig_with(cutoff={"max_on_s": 9.0}), "stuck-contact", None, "cut-off"),
        (rig_with(fan=None), "too-hot", None, None),
        (rig_with(fan={"interlocked": False}), "too-hot", None, None),
        (rig_with(limits={"max_on_s": 5.0}), "long-pulse", None, None),
        (rig_with(limits={"min_off_s": 15.0}), "no-rest", None, None),
        (rig_with(limits={"duty": 0.27}), "duty", None, "expected at most 0.27 of any 60 s; found 16.5"),
        (rig_with(limits={"max_temperature_c": 70}), "too-hot", None, "expected at most 70 C"),
        (rig_with(supply={"max_total_current_a": 7}), "supply", None, None),
        (rig_with(board={"contact_rating_a": 3}), "contact-rating", None, None),
        (
            rig_with(channels=[{"channel": 2, "spring": 0, "face": "front"}]),
            "other-wiring",
            None,
            "channel 2 .*; expected a spring that",
        ),
    ],
)
def test_arming_is_refused(rig, code, key, said):
    with raises(LimitError, f"limit.{code}", key, match=said):
        limits.check_schedule(SCHEDULE, rig)


def test_a_current_that_is_safe_for_ever_needs_no_cutoff():
    rig = rig_with(supply={"current_limit_a": 0.65}, cutoff=None, fan=None)
    schedule = compile_schedule(gait(duty=(0.05, 0.05), period=120.0), rig)
    assert schedule.predicted.stuck_c < 90


@pytest.mark.parametrize("current", [2.0, 4.0, 10.4, 11.0, 11.4, 50.0])
def test_the_hottest_springs_within_the_tolerance_are_checked(current):
    """Also where the supply is not at its limit, and less resistance means more heat."""
    rig = rig_with(supply={"current_limit_a": current}, board={"contact_rating_a": 100})
    worst = limits.worst_springs(rig)
    nominal = rig.spring_parameters()
    for factor in np.linspace(0.95, 1.05, 21):
        for more in (0.95, 1.0, 1.05):
            specimen = replace(
                nominal.with_resistance(nominal.resistance * factor),
                current_limit=current * more,
                supply_voltage=nominal.supply_voltage * more,
            )
            assert specimen.power(0.0) <= worst.power(0.0) * (1 + 1e-9)
    assert (worst.ambient, worst.convection_fan) == (30.0, pytest.approx(135.0))


def test_without_cooling_in_between_the_temperature_counts_from_the_last_pulse():
    """Short periods add up: each pulse alone is harmless."""
    rig = rig_with(limits={"min_off_s": 0.5, "duty": 1.0})
    with raises(LimitError, "limit.too-hot"):
        compile_schedule(gait(duty=(0.7, 0.0), period=8.0, phase=(0, 0)), rig)


@settings(max_examples=25, deadline=None)
@given(
    st.floats(8, 30),
    st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=2, max_size=2),
    st.sampled_from([8.0, 16.0]),
)
def test_what_is_compiled_breaks_no_limit(period, springs, budget):
    rig = rig_with(supply={"max_total_current_a": budget})
    phase, duty = np.array(springs).T
    try:
        schedule = compile_schedule(gait(phase, duty, period), rig, cycles=3)
    except LimitError:
        return
    dt = 0.05
    _, states = schedule.sampled(dt)
    assert 4 * states.sum(axis=1).max() <= budget
    for column in states.T:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], column, [0]])))
        on, off = edges[::2], edges[1::2]
        assert dt * (off - on).max(initial=0) <= rig.limits.max_on_s + dt + 1e-9
        assert dt * (on[1:] - off[:-1]).min(initial=1e6) >= rig.limits.min_off_s - dt - 1e-9
    worst = limits.worst_springs(rig)
    # Rounding of the samples.
    assert heat(states, dt, worst).temperature.max() <= rig.limits.max_temperature_c + 0.3


# What schedules say of themselves.

FORMER = {  # as version 0.1.0 wrote it, shortened
    "peak_c": 82.9,
    "stuck_c": 84.83,
    "method": "seen",
    "displacement": {
        "search": {
            "phase": [0.0, 0.875], "duty": [0.3, 0.3], "builds": 16, "fell": 16, "mean": None, "spread": None,
            "probability_forward": 0.0,
        },
        "seen": {
            "period_s": 20.0, "phase": [0.0, 0.5], "duty": [0.3, 0.3], "builds": 16, "fell": 0, "mean": 0.44,
            "spread": 0.12, "probability_forward": 1.0, "seen": 0.5,
        },
    },
    "cycle": {"t_s": [0.0], "channels": [1], "temperature_c": [[22.0]], "length_mm": [[35.0]]},
    "choice": "kept",
}  # fmt: skip


def test_a_schedule_of_version_0_1_0_loads(tmp_path):
    """Its walks said builds and seen; what is written says samples and filmed, in the same order."""
    source = {"eldir": "0.1.0", "seed": 1, "rig": "bench", "design": "d.json", "note": "by hand"}
    values = SCHEDULE.to_json() | {"predicted": FORMER, "provenance": source}
    path = tmp_path / "schedule.json"
    path.write_text(json.dumps(values))
    loaded = ActuationSchedule.load(path)
    assert loaded.predicted.method == "filmed" and loaded.provenance.design == "d.json"
    assert loaded.predicted.walk is loaded.predicted.displacement["filmed"]
    assert loaded.predicted.walk.samples == 16 and loaded.predicted.walk.filmed == 0.5
    assert loaded.predicted.displacement["search"].mean is None
    written = json.dumps(loaded.to_json())
    jsonschema.validate(json.loads(written), schema("schedule"))
    renamed = json.dumps(values).replace('"builds"', '"samples"').replace('"seen"', '"filmed"')
    assert written == renamed
    assert ActuationSchedule.from_json(json.loads(written)) == loaded


def test_a_schedule_by_hand_predicts_nothing(tmp_path):
    values = SCHEDULE.to_json() | {"predicted": {}, "provenance": {}}
    loaded = ActuationSchedule.from_json(values)
    assert loaded.predicted.walk is None and loaded.to_json() == values


def test_the_schedule_of_the_ros_package_loads():
    file = SCHEMAS.parents[1] / "ros2_nodes" / "eldir_ros" / "config" / "schedule.json"
    walk = ActuationSchedule.load(file).predicted.walk
    assert walk is not None and walk.samples == 16 and walk.period_s is None


# Rig files.


def test_rig_files_follow_their_schema():
    for text in (virtual_rig(), virtual_rig(3, "design.json"), real_rig("lcus", "/dev/ttyUSB0")):
        jsonschema.validate(yaml.safe_load(text), schema("rig"))
        Rig.from_json(yaml.safe_load(text))


def test_a_fresh_real_rig_does_not_arm(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(real_rig("lcus", "/dev/ttyUSB0"))
    with raises(LimitError, "limit.not-measured", "springs.resistance_ohm"):
        limits.check_schedule(SCHEDULE, Rig.load(path))


@pytest.mark.parametrize(
    ("old", "new", "code", "key", "said"),
    [
        ("kind: lcus", "kind: a0", "rig.inconsistent", "board.kind", "expected feedback | gd32 | lcus |"),
        ("channel: 2", "channel: 1", "rig.inconsistent", None, "a relay channel is listed twice"),
        ("channels: 4", "channels: 2", "rig.inconsistent", None, "does not exist: the board has 2 channels"),
        ("contact_rating_a: 10", "contact_rating: 10", "rig.missing-key", "board.contact_rating_a", ""),
        ("channels: 4", "channels: 12", "rig.inconsistent", "board", "lcus has at most 8 channels"),
        ("voltage_v: 11", "voltage_v: -11", "rig.wrong-value", "supply.voltage_v", ""),
        (
            "max_temperature_c: 90",
            "max_temperature_c: 120",
            "rig.wrong-value",
            "limits.max_temperature_c",
            "",
        ),
        ("max_total_current_a: 16", "budget: 16", "rig.missing-key", "supply.max_total_current_a", ""),
        ("\nname:", "\n\tname:", "file.damaged", None, ""),
        ("eldir-rig/1", "eldir-rig/9", "file.other-format", None, ""),
    ],
)
def test_a_wrong_rig_file_is_named(tmp_path, old, new, code, key, said):
    path = tmp_path / "rig.yaml"
    path.write_text(virtual_rig().replace(old, new, 1))
    with raises(InputError, code, key, match=re.escape(said)):
        Rig.load(path)


def test_cycles_count_after_settling_and_conditioning():
    events = (Event(0.0, 0, "front", 1, True), Event(2.0, 0, "front", 1, False))
    schedule = ActuationSchedule(20.0, events=events, cycles=3, settle_s=3.0)
    assert [schedule.cycle_at(t) for t in (-1.0, 22.9, 23.0, 43.1, 500.0)] == [0, 0, 1, 2, 3]
