"""Schedules as messages, without ROS: nothing is lost, and an edited one is known."""

import hashlib
import json
from dataclasses import replace

import pytest
from eldir_msgs.action import RunSchedule

from eldir.errors import InputError
from eldir_hardware.safety.compatibility import MismatchError, require_compatible, with_digests
from eldir_hardware.schedule import ActuationSchedule, Event, SchedulePrediction, ScheduleProvenance
from eldir_ros.conversions import schedules
from tests.hardware.rigs_and_schedules import SCHEDULE, rig_with
from tests.raised import raises
from tests.ros2_nodes.message_types import passed


def test_a_schedule_travels_as_fields():
    origin = {"eldir": "0.2.0", "seed": 3, "rig": "a rig", "design": "design.json"}
    plain = ActuationSchedule(
        20.0,
        events=(Event(0.0, 0, "front", 1, True), Event(2.001, 0, "front", 1, False)),
        cycles=3,
        settle_s=3.3,
        springs=(7,),
    )
    made = with_digests(replace(plain, provenance=ScheduleProvenance(**origin)), rig_with())
    for sent in (plain, made):
        found = schedules.schedule_from(passed(schedules.schedule_of(sent)))
        assert found == sent, "to the last digit, with the digest of itself"
    found = schedules.without_predictions(replace(made, predicted=SchedulePrediction(peak_c=61.0)))
    assert require_compatible(made, rig_with(), None) is None and found.predicted == SchedulePrediction()


def test_a_schedule_that_was_edited_is_told_from_one_of_eldir_gait():
    """In its file, or in the fields of its message."""
    rig = rig_with()
    made = with_digests(replace(SCHEDULE, springs=(7, 9)), rig)
    assert require_compatible(schedules.schedule_from(schedules.schedule_of(made)), rig, None) is None
    with_predictions = with_digests(
        replace(SCHEDULE, springs=(7, 9), predicted=SchedulePrediction(peak_c=61.0)), rig
    )
    kept = schedules.schedule_from(passed(schedules.schedule_of(with_predictions)))
    assert require_compatible(kept, rig, None) is None, "predictions stay at home"
    in_file = schedules.schedule_of(replace(made, cycles=made.cycles + 1))
    in_message = schedules.schedule_of(made)
    in_message.cycles += 1
    for message in (in_file, in_message):
        with raises(MismatchError, "schedule.made-for-another", match="it was edited after eldir gait"):
            require_compatible(schedules.schedule_from(passed(message)), rig, None)


def test_the_digest_of_a_plan_is_the_one_that_the_message_defines():
    """With the text as ScheduleOrigin.msg says it, so that a foreign client can make it."""
    plan = ActuationSchedule(
        20.0,
        events=(Event(0.0, 0, "front", 1, True), Event(2.5, 0, "front", 1, False)),
        cycles=3,
        conditioning_cycles=1,
        settle_s=3.0,
        springs=(7,),
    )
    text = "20000000000 3 1 3000000000 7\n0 0 0 1 1\n2500000000 0 0 1 0"
    assert schedules.plan_digest(schedules.schedule_of(plan)) == hashlib.sha256(text.encode()).hexdigest()


def test_what_is_no_schedule_is_refused():
    text = json.dumps(SCHEDULE.to_json())
    assert schedules.read_schedule(text) == SCHEDULE
    for wrong in ("", "[]", '{"format": "eldir-rig/1"}', text.replace("period_s", "period")):
        with pytest.raises(InputError):
            schedules.read_schedule(wrong)
    message = schedules.schedule_of(SCHEDULE)
    message.events[0].face = 3
    with pytest.raises(InputError, match=r"expected FRONT, BACK or BOTH; found \[3\]"):
        schedules.schedule_from(message)
    with pytest.raises(InputError, match="period_s"):
        schedules.schedule_from(RunSchedule.Goal().schedule)
