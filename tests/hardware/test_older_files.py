"""Files of earlier versions load, mean the same, and keep their bytes when they are written again."""

import json
import re

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from eldir.core.yaml_files import parse_yaml
from eldir.errors import InputError
from eldir_app.catalogue.facts import notes_file, read_notes, write_notes
from eldir_hardware.log.reader import read_log
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.compatibility import rig_digests, schedule_digest
from eldir_hardware.schedule import ActuationSchedule
from tests.paths import ROOT
from tests.raised import raises

OLD = ROOT / "tests" / "data" / "old"
PRESENT = ROOT / "ros2_nodes" / "eldir_ros" / "config" / "rig.yaml"


def test_schedules_keep_their_bytes_and_digests(tmp_path):
    ros = ROOT / "ros2_nodes" / "eldir_ros" / "config" / "schedule.json"
    for path, channels, heated in ((OLD / "schedule.json", 4, 0.5), (ros, 4, 6.0)):
        schedule = ActuationSchedule.load(path)
        schedule.save(tmp_path / "again.json")
        assert (tmp_path / "again.json").read_bytes() == path.read_bytes()
        assert schedule_digest(schedule) == schedule.provenance.digests.schedule
        assert len(schedule.channels) == channels and schedule.pulses()[0].length == heated
    assert ActuationSchedule.load(OLD / "schedule.json").provenance.hold == 0.3


def test_other_entries_of_where_a_schedule_comes_from_are_kept():
    values = json.loads((OLD / "schedule.json").read_text())
    values["provenance"] |= {"bench": "3", "notes": [1]}
    again = ActuationSchedule.from_json(values).to_json()
    assert again["provenance"] == values["provenance"]
    assert ActuationSchedule.from_json(again) == ActuationSchedule.from_json(values)


def test_notes_keep_their_bytes(tmp_path):
    notes = read_notes(OLD / "run.mcap")
    assert notes.tags == ("b-2", "good") and notes.notes[0].text == "Slipped at 40 s; läuft wieder"
    written = write_notes(tmp_path / "run.mcap", notes)
    assert written.read_bytes() == notes_file(OLD / "run.mcap").read_bytes()


def test_a_rig_file_with_old_names_is_refused_with_the_new_ones(tmp_path):
    """One after the other, until the file is as this version writes it."""
    path = tmp_path / "rig.yaml"
    text, count = (OLD / "rig.yaml").read_text(), 0
    while True:
        path.write_text(text)
        try:
            rig = Rig.load(path)
        except InputError as error:
            assert error.code == "rig.renamed-key"
            section, old = str(error.key).split(".")
            [new] = re.findall(
                rf"{error.key} has another name now; expected {section}\.(\w+); rename it: \1: ", str(error)
            )
            before, place, after = text.partition(f"\n{section}:")
            text, count = before + place + after.replace(f"{old}:", f"{new}:", 1), count + 1
        else:
            break
    assert rig.to_json() == Rig.load(PRESENT).to_json() and count == 8


@pytest.mark.parametrize("value", ["2024-01-01", "!!binary aGVsbG8=", "far", "[1, {a: b}]"])
def test_whatever_an_old_name_holds_one_line_says_its_new_one(tmp_path, value):
    path = tmp_path / "rig.yaml"
    path.write_text(re.sub(r"max_temperature_c: [\d.]+", f"ceiling_c: {value}", PRESENT.read_text()))
    expected = r"ceiling_c has another name now; expected limits\.max_temperature_c; rename it: (?!.*large)"
    with raises(InputError, "rig.renamed-key", "limits.ceiling_c", match=expected):
        Rig.load(path)


def test_a_log_with_old_names_has_the_same_rig():
    old = Rig.from_json(parse_yaml((OLD / "rig.yaml").read_bytes(), "the log"))
    assert old.to_json() == Rig.load(PRESENT).to_json()
    values = Rig.load(PRESENT).to_json()
    for word in ("specimen", "deviation"):
        far = Rig.from_json({**values, "virtual": {"seed": 5, word: "far"}})
        assert far.virtual.parameter_spread == "large"


def test_a_schedule_fits_the_rig_whose_entries_have_other_names():
    written = ActuationSchedule.load(PRESENT.with_name("schedule.json")).provenance.digests
    assert written is not None and written.rig == rig_digests(Rig.load(PRESENT))


def test_a_log_with_positions_for_contacts_and_currents_is_read():
    """As version 0.1.0 wrote them: sensor_msgs/JointState."""
    with AnyReader([OLD / "currents.mcap"]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
    assert kinds["/relays"] == kinds["/currents"] == "sensor_msgs/msg/JointState"
    log = read_log(OLD / "currents.mcap")
    assert log.channels == ("channel1", "channel2") and log.springs == ("spring0_front", "spring0_back")
    assert log.relays[:, 0].tolist() == [False, True, True, True, False, False]
    assert log.relays[:, 1].tolist() == [False, False, True, True, True, True]
    front = log.springs.index("spring0_front")
    assert log.currents[:, front].tolist() == [0.0, 3.25, 3.25, 3.25, 0.0, 0.0]
    assert np.isnan(log.currents[:, 1 - front]).all() and (log.voltages[:, front] == 3.0).all()
