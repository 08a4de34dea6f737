"""A schedule is played for the design and the rig that it was made for, and as it was made."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.lattice import Lattice
from eldir.parameters.wiring import wiring, wiring_digest
from eldir_app.commands.rig import rig as command
from eldir_hardware.log._salvage import valid_records
from eldir_hardware.log.reader import read_log
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.rig.template import real_rig
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.safety.compatibility import (
    MismatchError,
    design_digest,
    require_compatible,
    rig_digests,
    schedule_digest,
    with_digests,
)
from eldir_hardware.safety.limits import check_schedule
from eldir_hardware.schedule import MAX_EVENTS, MAX_PERIOD, ActuationSchedule, Event
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import RIG, SCHEDULE, gait, rig_text, rig_with
from tests.paths import ROOT
from tests.processor_time import in_units
from tests.raised import raises

NO_CAMERA = rig_text().replace("camera:", "# camera:")


@pytest.fixture(scope="module")
def design() -> Design:
    return make_design(3, Lattice(3, 6))


@pytest.fixture(scope="module")
def made(design: Design) -> ActuationSchedule:
    springs = tuple(int(s) for s in np.flatnonzero(design.morphology.active))
    return with_digests(compile_schedule(gait(), RIG, springs, cycles=1), RIG, design)


def test_the_wiring_is_that_of_the_motors_which_the_schedule_names():
    """All of the rig's where it names none."""
    rig = rig_with()
    one, two, none = (
        with_digests(replace(SCHEDULE, springs=named), rig).provenance.digests.wiring
        for named in ((4,), (4, 7), ())
    )
    assert rig.motors == 2 and one == wiring_digest(wiring(1)) and two == none == wiring_digest(wiring(2))


def test_it_is_played_for_what_it_was_made_for(design, made, tmp_path):
    made.save(tmp_path / "schedule.json")
    loaded = ActuationSchedule.load(tmp_path / "schedule.json")
    design.save(tmp_path / "design.json")
    assert loaded == made and loaded.to_json() == made.to_json()
    assert require_compatible(loaded, RIG, Design.load(tmp_path / "design.json")) is None
    assert require_compatible(loaded, RIG, None) is None, "a rig knows no design"
    assert schedule_digest(loaded) == made.provenance.digests.schedule


def changed(made: ActuationSchedule, **changes: object) -> ActuationSchedule:
    return ActuationSchedule.from_json(made.to_json() | changes)


def test_an_edited_schedule_is_refused(design, made):
    values = made.to_json()
    events = [dict(e) for e in values["events"]]
    events[-1]["t_s"] += 0.001
    for what in (
        {"cycles": 2},
        {"settle_s": 2.5},
        {"events": events},
        {"springs": [0, 1]},
        {"predicted": {}},
        {"provenance": values["provenance"] | {"design": "other.json"}},
    ):
        with pytest.raises(MismatchError, match="it was edited after eldir gait; make it again: eldir gait"):
            require_compatible(changed(made, **what), RIG, design)


def test_a_schedule_of_another_design_is_refused(design, made):
    other = make_design(4, Lattice(3, 6))
    heavier = replace(design, variant=replace(design.variant, without_motor=0))
    for robot in (other, heavier):
        with pytest.raises(MismatchError, match="it was made for another design"):
            require_compatible(made, RIG, robot)
    same = replace(design, provenance={"note": "found again"}, other_parts=("pitch",))
    assert design_digest(same) == design_digest(design)
    with pytest.raises(MismatchError, match="it lacks the digest of its design"):
        require_compatible(SCHEDULE, RIG, design)


@pytest.mark.parametrize(
    ("section", "change"),
    [
        ("supply", {"current_limit_a": 3.5}),
        ("springs", {"resistance_ohm": 1.1}),
        ("tolerances", {"current": 0.06}),
        ("fan", {"interlocked": False}),
        ("cutoff", {"max_on_s": 6.4}),
        ("limits", {"max_temperature_c": 89}),
    ],
)
def test_a_schedule_for_other_rig_values_is_refused(design, made, section, change):
    with pytest.raises(MismatchError, match=f"the rig file has other values in {section};"):
        require_compatible(made, rig_with(**{section: change}), design)


def test_every_difference_is_named(design, made):
    other = rig_with(supply={"current_limit_a": 3.5}, limits={"max_temperature_c": 89})
    message = "it was edited after eldir gait; the rig file has other values in supply, limits; make it again"
    with pytest.raises(MismatchError, match=message):
        require_compatible(changed(made, cycles=2), other, design)


def test_the_order_of_entries_in_the_file_does_not_matter(made, tmp_path):
    """A program that reads and writes JSON may sort them."""
    noted = with_digests(
        replace(made, provenance=replace(made.provenance, notes={"hold": 0.3, "by": "hand"})), RIG
    )
    (tmp_path / "schedule.json").write_text(json.dumps(noted.to_json(), sort_keys=True))
    assert require_compatible(ActuationSchedule.load(tmp_path / "schedule.json"), RIG, None) is None


def test_what_does_not_heat_does_not_matter(tmp_path):
    """Port, board, camera, name, comments, and entries that say their default."""
    text = rig_text(seed=99).replace("rate_hz: 10", "rate_hz: 20").replace("virtual bench", "other")
    (tmp_path / "rig.yaml").write_text(
        "# a comment\n" + text.replace("ambient_c: 22", "ambient_c: 22.0, turns: 26.7")
    )
    assert rig_digests(Rig.load(tmp_path / "rig.yaml")) == rig_digests(RIG)
    values = yaml.safe_load(real_rig("gd32", "/dev/ttyUSB3"))
    values |= {name: yaml.safe_load(rig_text())[name] for name in ("supply", "springs", "fan", "cutoff")}
    assert rig_digests(Rig.from_json(values)) == rig_digests(RIG)


def test_a_schedule_without_digests_is_refused(made):
    values = made.to_json()
    values["provenance"].pop("digests")
    with pytest.raises(MismatchError, match="it lacks the digests of its design and rig; make it again"):
        require_compatible(ActuationSchedule.from_json(values), RIG, None)


@pytest.mark.parametrize("springs", [(), (7,)])
def test_springs_that_are_not_named_are_refused_always(springs):
    short = with_digests(replace(SCHEDULE, springs=springs), RIG)
    with raises(InputError, "schedule.springs-missing", match=r"expected 2 indices"):
        require_compatible(short, RIG, None, "I know")


@pytest.mark.parametrize(
    ("digests", "code", "key"),
    [
        ([], "wrong-value", "digests"),
        ("x", "wrong-value", "digests"),
        ({}, "missing-key", "digests.schedule"),
        ({"schedule": 1}, "wrong-value", "digests.schedule"),
        ({"schedule": "a", "rig": 3}, "wrong-value", "digests.rig"),
        ({"rig": {}}, "missing-key", "digests.schedule"),
    ],
)
def test_damaged_digests_are_refused_in_one_line(made, digests, code, key, tmp_path):
    values = made.to_json()
    values["provenance"]["digests"] = digests
    (tmp_path / "schedule.json").write_text(json.dumps(values))
    with raises(InputError, f"schedule.{code}", f"provenance.{key}"):
        ActuationSchedule.load(tmp_path / "schedule.json")


def drive(folder: Path, schedule: ActuationSchedule, *more: str):
    (folder / "rig.yaml").write_text(NO_CAMERA)
    schedule.save(folder / "schedule.json")
    files = ["schedule.json", "--rig", "rig.yaml", "--log", "log.mcap"]
    words = ["drive", *(f if f.startswith("--") else str(folder / f) for f in files), *more]
    return CliRunner().invoke(command, words)


def test_the_command_refuses_and_plays_with_a_reason(tmp_path):
    edited = replace(SCHEDULE, cycles=1, conditioning_cycles=0)
    refused = drive(tmp_path, edited)
    assert isinstance(refused.exception, MismatchError)
    message = str(refused.exception)
    assert "it was edited after eldir gait" in message and "--accept-mismatch" in message
    assert not (tmp_path / "log.mcap").exists()
    assert isinstance(drive(tmp_path, edited, "--accept-mismatch", " ").exception, MismatchError)
    played = drive(tmp_path, edited, "--accept-mismatch", "bench test,\nno robot")
    assert played.exit_code == 0, played.output
    log = read_log(tmp_path / "log.mcap")
    line = "the schedule was accepted although it was edited after eldir gait: bench test, no robot"
    assert line in [text for _, _, text in log.statuses]
    notes = [
        r.metadata for r in valid_records((tmp_path / "log.mcap").read_bytes()) if hasattr(r, "metadata")
    ]
    assert notes and all("bench test" in note["accepted"] for note in notes)
    assert notes[0]["rig_sha256"] == Rig.load(tmp_path / "rig.yaml").digest
    assert notes[0]["schedule_sha256"] == schedule_digest(edited)


def test_no_reason_lifts_a_limit(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(NO_CAMERA)
    too_long = compile_schedule(gait(duty=(0.275, 0.275)), rig_with(limits={"max_on_s": 6}), (7, 12))
    hot = replace(
        too_long, events=tuple(sorted(replace(e, t_s=e.t_s + (0 if e.on else 1)) for e in too_long.events))
    )
    with pytest.raises(LimitError):
        drive_rig(hot, Rig.load(path), path, tmp_path / "log.mcap", DriveConfig(accept_mismatch="I want it"))
    assert not (tmp_path / "log.mcap").exists()


def test_another_design_on_the_command_line_is_refused(design, made, tmp_path):
    make_design(4, Lattice(3, 6)).save(tmp_path / "other.json")
    refused = drive(tmp_path, made, "--design", str(tmp_path / "other.json"))
    assert isinstance(refused.exception, MismatchError) and "another design" in str(refused.exception)


def test_the_example_of_the_ros_nodes_fits_together():
    folder = ROOT / "ros2_nodes" / "eldir_ros" / "config"
    schedule = ActuationSchedule.load(folder / "schedule.json")
    try:
        assert (
            require_compatible(schedule, Rig.load(folder / "rig.yaml"), Design.load(folder / "design.json"))
            is None
        )
    except EldirError as error:  # seal it again with `with_digests`, or make it again with eldir gait
        pytest.fail(str(error))


def mutations(values: object):
    """The values with each one replaced in turn by something of another kind, or removed."""
    places: list[tuple] = []

    def walk(value, place):
        places.append(place)
        inner = (
            value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        )
        for name, part in inner:
            walk(part, (*place, name))

    walk(values, ())
    for place in places[1:]:
        for other in (None, True, "nan", -1, 2**62, 1e300, [], {}, [[]], "removed"):
            copy = json.loads(json.dumps(values))
            holder = copy
            for name in place[:-1]:
                holder = holder[name]
            if other == "removed":
                del holder[place[-1]]
            else:
                holder[place[-1]] = other
            yield place, other, copy


def test_a_schedule_with_any_wrong_value_is_refused_in_one_line(made, design, tmp_path):
    """Never a traceback, whatever is in the file; what is accepted is found edited, or says the same."""
    accepted = 0
    for place, other, values in mutations(made.to_json()):
        try:
            schedule = ActuationSchedule.load(write(tmp_path / "schedule.json", values))
            check_schedule(schedule, RIG) if place[0] == "events" and len(place) == 2 else None
            require_compatible(schedule, RIG, design)
            accepted += 1
        except EldirError as error:
            assert "\n" not in str(error) and len(str(error)) < 600, (place, other)
        else:
            assert schedule == made, (place, other)
    print(f"{accepted} mean the same")


@pytest.mark.parametrize("wrong", ["far", True, [1.0], {}])
def test_predictions_are_numbers(wrong):
    for predicted in ({"peak_c": wrong}, {"displacement": {"search": {"mean": wrong}}}):
        with pytest.raises(InputError, match=r"invalid \S*(peak_c|mean); expected a valid number"):
            ActuationSchedule.from_json(SCHEDULE.to_json() | {"predicted": predicted})


def write(path: Path, values: object) -> Path:
    path.write_text(json.dumps(values))
    return path


def test_the_largest_schedule_is_checked_in_a_second():
    """A hundred units of work are a second on a processor of 2021; three times that is refused."""
    rig = rig_with(limits={"min_off_s": 0.1, "duty": 1.0})
    wired = [(c.channel, c.spring, c.face) for c in rig.channels]
    count = MAX_EVENTS // 2 // len(wired)
    step = MAX_PERIOD / count
    events = [
        Event(i * step + (0.0 if on else 0.2), spring, face, channel, on)
        for channel, spring, face in wired
        for i in range(count)
        for on in (True, False)
    ]
    begun = time.process_time()
    schedule = ActuationSchedule(MAX_PERIOD, events=tuple(sorted(events)), springs=(7, 12))
    check_schedule(schedule, rig)
    taken = in_units(time.process_time() - begun)
    print(f"{len(events)} events in {MAX_PERIOD:g} s: {taken:.0f} units")
    assert taken < 300
    with raises(InputError, "schedule.wrong-value", "events", match=" 256"):
        replace(schedule, events=(*schedule.events, *schedule.events[:2]))
    with raises(InputError, "schedule.wrong-value", "period_s", match=" 120; found 121"):
        replace(schedule, period_s=121.0)
