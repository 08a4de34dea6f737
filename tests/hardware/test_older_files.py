"""Files of earlier versions load, mean the same, and keep their bytes when they are written again."""

import json

from hardware.catalogue.notes import notes_file, read_notes, write_notes
from hardware.safety.schedule_digests import schedule_digest
from hardware.schedule import ActuationSchedule
from tests.paths import ROOT

OLD = ROOT / "tests" / "data" / "old"


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
