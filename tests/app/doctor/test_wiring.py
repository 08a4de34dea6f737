"""Channels heat the springs that the packet says: one map, differences are told, and a person can see it."""

import csv
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml

from eldir.errors import EldirError, InputError
from eldir.parameters.wiring import Connection, wiring, wiring_digest
from eldir_app.switching_checks import MAX_TOUCH_C, describe_spring, warm_each, warming_pulse
from eldir_cad.geometry.assembly import assemble
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet._drawing import draw_assembly_map
from eldir_cad.packet.wiring_file import read_wiring
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.log.reader import read_log
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.rig.template import real_rig
from eldir_hardware.run.drive import open_bank
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.virtual.rig import VirtualRig
from tests.cad.drawn_bodies import body
from tests.cad.written_packet import ROBOT, written_packet
from tests.forked_programs import Forked
from tests.hardware.emulated_rigs import emulated, rig_file, run, wait
from tests.hardware.rigs_and_schedules import RIG, gait, rig_text, rig_with
from tests.hardware.safety.independent_heat import temperatures
from tests.hardware.safety.replayed_heat import HOTTEST, NOMINAL, wire
from tests.hardware.virtual.piston_and_observer import Piston
from tests.paths import SCHEMAS
from tests.raised import raises

MAP = {1: (0, "front"), 2: (0, "back"), 3: (1, "front"), 4: (1, "back")}
FORMER = {1: (0, "front"), 2: (1, "front"), 3: (0, "back"), 4: (1, "back")}
"""What packets said before they and the rig file had one map."""


def channels(places: dict[int, tuple[int, str]]) -> list[dict[str, object]]:
    return [{"channel": c, "spring": spring, "face": face} for c, (spring, face) in places.items()]


@pytest.fixture(scope="module")
def packet(tmp_path_factory) -> Path:
    return written_packet(tmp_path_factory)


def test_packet_rig_files_and_schedule_have_one_map(packet):
    """The report's is compared in tests/product/test_demo.py."""
    with (packet / "wiring.csv").open() as file:
        told = {int(r["relay_channel"]): (int(r["spring"]), r["face"]) for r in csv.DictReader(file)}
    assert told == MAP
    for text in (rig_text(), real_rig("lcus", "/dev/ttyUSB0")):
        entries = yaml.safe_load(text)["channels"]
        assert {e["channel"]: (e["spring"], e["face"]) for e in entries} == MAP
    schedule = compile_schedule(gait(), RIG, (3, 20)).to_json()
    assert {e["channel"]: (e["spring"], e["face"]) for e in schedule["events"]} == MAP


def test_the_assembly_map_has_it_too():
    spec = load_specification()
    figure = draw_assembly_map(assemble(ROBOT.morphology, spec, ROBOT.marks), wiring(2))
    drawn = [[t.get_text() for t in axes.texts if t.get_text().startswith("S")] for axes in figure.axes]
    assert drawn[:2] == [["S0 / 1", "S1 / 3"], ["S0 / 2", "S1 / 4"]], "the third is the legend"
    assert any(wiring_digest(wiring(2))[:8] in t.get_text() for t in figure.texts)


def test_digests_of_packet_and_schedule_agree(packet):
    manifest = json.loads((packet / "manifest.json").read_text())
    schedule = with_digests(compile_schedule(gait(), RIG, (3, 20)), RIG).to_json()
    assert manifest["wiring"]["sha256"] == schedule["provenance"]["digests"]["wiring"]
    jsonschema.validate(manifest, json.loads((SCHEMAS / "packet-manifest.schema.json").read_text()))
    jsonschema.validate(schedule, json.loads((SCHEMAS / "schedule.schema.json").read_text()))
    other = rig_with(channels=channels(FORMER))
    elsewhere = with_digests(compile_schedule(gait(), other, (3, 20)), other).to_json()
    assert manifest["wiring"]["sha256"] != elsewhere["provenance"]["digests"]["wiring"]


def test_a_motors_channels_do_not_depend_on_the_other_motors():
    assert wiring(1) == wiring(3)[:2]
    assert wiring_digest(wiring(2)) == wiring_digest(reversed(wiring(2)))


@pytest.fixture
def swapped(tmp_path) -> Path:
    """A rig file that says what its user wired, after a packet of an older version."""
    values = yaml.safe_load(rig_text()) | {"channels": channels(FORMER)}
    del values["camera"]
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(values))
    return tmp_path / "rig.yaml"


DIFFERS = "channel 2 heats spring 0 back in the packet, spring 1 front on the rig"


def test_another_map_is_driven_and_told(swapped):
    rig = Rig.load(swapped)
    schedule = with_digests(compile_schedule(gait(), rig, (3, 20), cycles=1), rig)
    schedule.save(swapped.with_name("schedule.json"))
    log = swapped.with_name("log.mcap")
    driven = run("drive", swapped.with_name("schedule.json"), "--rig", swapped, "--log", log)
    assert driven.exit_code == 0 and DIFFERS in driven.output
    assert any(DIFFERS in message for _, _, message in read_log(log).statuses)
    relays = np.asarray(read_log(log).relays)
    assert relays.any(axis=0).all()


def test_a_rig_wired_by_the_packet_is_told_nothing(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text().replace("camera:", "# camera:"))
    schedule = with_digests(compile_schedule(gait(), RIG, (3, 20), cycles=1), RIG)
    schedule.save(tmp_path / "schedule.json")
    driven = run("drive", tmp_path / "schedule.json", "--rig", path, "--log", tmp_path / "log.mcap")
    assert driven.exit_code == 0 and "not wired" not in driven.output
    assert not any("not wired" in message for _, _, message in read_log(tmp_path / "log.mcap").statuses)


def finding(result) -> dict[str, object]:
    return next(f for f in json.loads(result.stdout) if f["subject"] == "wiring")


def test_the_doctor_compares_with_a_packet(packet, swapped, tmp_path):
    found = finding(run("doctor", "--rig", swapped, "--json"))
    assert found["ok"] and DIFFERS in found["text"], "allowed: its user wired so"
    refused = run("doctor", "--rig", swapped, "--packet", packet, "--json")
    assert refused.exit_code == 1
    assert not finding(refused)["ok"] and DIFFERS in finding(refused)["text"]
    assert f"(wiring {wiring_digest(wiring(2))[:8]} in the packet, " in finding(refused)["text"]
    (tmp_path / "same.yaml").write_text(rig_text())
    assert finding(run("doctor", "--rig", tmp_path / "same.yaml", "--packet", packet, "--json"))["ok"]


def test_a_packet_of_an_older_version_is_read(packet, swapped, tmp_path):
    """By its table: its manifest has no digest, and a person has filled in resistances."""
    with (packet / "wiring.csv").open() as file:
        rows = list(csv.DictReader(file))
    number = {place: channel for channel, place in FORMER.items()}
    for row in rows:
        row["relay_channel"] = number[int(row["spring"]), row["face"]]
        row["resistance_ohm_measured"] = "1.02"
    with (tmp_path / "wiring.csv").open("w") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    assert {c.channel: (c.spring, c.face) for c in read_wiring(tmp_path)} == FORMER
    assert finding(run("doctor", "--rig", swapped, "--packet", tmp_path, "--json"))["ok"]


HEADER = "spring,face,relay_channel\n"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "no rows"),
        (HEADER, "no rows"),
        ("a,b\n1,2\n", "relay_channel"),
        (f"{HEADER}0,left,1\n", "face 'left'"),
        (f"{HEADER}0,front,99\n", "channel 99"),
        (f"{HEADER}0,front,0\n", "channel 0"),  # relay boards count from 1
        (f"{HEADER}-1,front,1\n", "spring -1"),
        (f"{HEADER}0,front,2\n0,back,1\n1,front,2\n", "channel 2 in two rows"),
        ("\x00", ""),
    ],
)
def test_what_is_no_wiring_is_refused(text, found, tmp_path):
    (tmp_path / "wiring.csv").write_text(text)
    with raises(InputError, "file.damaged", match=rf"wiring\.csv .*{found}"):
        read_wiring(tmp_path)


def warmed(rig: Rig) -> tuple[list[Connection], list[tuple[float, int, bool]]]:
    """What is told, and the switchings of the emulated contacts."""
    told: list[Connection] = []
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)

        def tell(connection: Connection) -> None:
            closed = [i for i, c in enumerate(virtual.emulator.contacts, start=1) if c]
            assert closed == [connection.channel]
            told.append(connection)

        warm_each(bank, virtual.clock, rig.channels, warming_pulse(rig), tell)
        edges = [(e.t, e.channel, e.closed) for e in virtual.emulator.contact_events]
        assert not any(virtual.emulator.contacts)
    return told, edges


@pytest.mark.parametrize("rig", [RIG, rig_with(channels=channels(FORMER))], ids=["packet", "other"])
def test_each_channel_is_closed_once_and_alone(rig):
    told, edges = warmed(rig)
    assert told == list(rig.channels)
    assert [(c, closed) for _, c, closed in edges] == [
        (c.channel, closed) for c in rig.channels for closed in (True, False)
    ]
    times = np.array([t for t, _, _ in edges]).reshape(-1, 2)
    assert np.diff(times, axis=1).max() < warming_pulse(rig) + 0.1
    assert (times[1:, 0] - times[:-1, 1]).min() > 3.5, "time to look"


def test_springs_grow_warm_and_no_more():
    """By the independent thermal model, with the trace's longest pulse."""
    _, edges = warmed(RIG)
    longest = max(b[0] - a[0] for a, b in zip(edges[::2], edges[1::2], strict=True))
    assert max(temperatures(wire(RIG, HOTTEST), [(0.0, longest)], 3.0)) < MAX_TOUCH_C
    assert max(temperatures(wire(RIG, NOMINAL), [(0.0, longest)], 3.0)) > RIG.springs.ambient_c + 12


def test_a_rig_that_must_not_heat_warms_nothing():
    for rig in (rig_with(supply={"current_limit_a": None}), rig_with(limits={"max_temperature_c": 70})):
        with pytest.raises(LimitError):
            warming_pulse(rig)
    with raises(LimitError, "limit.warm-hands"):
        warming_pulse(rig_with(tolerances={"ambient_max_c": 47.5}, supply={"current_limit_a": 2.5}))
    for short in (0.06, 0.4):  # springs stay cold: it is no heat that must be lowered
        with pytest.raises(
            LimitError, match=r"no pulse in which a spring gets warm.*expected 0\.6 s or more"
        ):
            warming_pulse(rig_with(limits={"max_on_s": short}))


def test_the_doctor_warms_nothing_after_a_failure(packet, tmp_path):
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port, channels=channels(FORMER))
        result = run("doctor", "--rig", path, "--packet", packet, "--wiring")
        assert result.exit_code == 1 and "grow warm" not in result.output and not board.contact_events


def test_ctrl_c_opens_the_contacts(tmp_path):
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        ROBOT.save(tmp_path / "design.json")
        call = [sys.executable, "-m", "eldir", "rig", "doctor", "--rig", path, "--wiring"]
        with Forked(
            [*map(str, call), "--design", str(tmp_path / "design.json")],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        ) as doctor:
            try:
                assert wait(lambda: any(board.contacts), 30)
                doctor.send_signal(signal.SIGINT)
                begun = time.monotonic()
                assert wait(lambda: not any(board.contacts), 5)
                took = time.monotonic() - begun
                said = doctor.communicate(timeout=20)[1]
            finally:
                doctor.kill()
        assert doctor.returncode == 130 and took < warming_pulse(RIG) / 2
        assert [(e.channel, e.closed) for e in board.contact_events] == [(1, True), (1, False)]
        assert "stopped by Ctrl-C; all contacts are open" in said and "channel 2" not in said
        assert run("reset", "--rig", path).exit_code == 0


def test_a_virtual_rig_in_real_time_has_a_guardian():
    rig = rig_with(virtual={"clock": "wall"})
    told: list[Connection] = []
    with open_bank(rig) as opened:
        warm_each(opened.bank, opened.clock, rig.channels[:1], 0.5, told.append, pause=0.0)
    assert told == [Connection(1, 0, "front")]


def test_a_contact_that_does_not_close_is_an_error():
    with VirtualRig(RIG, Piston()) as virtual:
        bank = PulseController(virtual.board, RIG, virtual.clock)
        bank.heat = lambda at, lengths: None
        with raises(EldirError, "doctor.not-closed", match="channel 1"):
            warm_each(bank, virtual.clock, RIG.channels, 1.0, lambda connection: None)


def test_places_are_told():
    """Two triangles in a row, the motor at its front end."""
    found = body("11", motors=(0, 4))
    ends = found.springs[found.active]
    for motor, (a, b) in enumerate(ends):
        x = found.positions[[a, b], 0].mean() - found.positions[:, 0].min()
        end = "rear end" if x < np.ptp(found.positions[:, 0]) / 3 else "front end"
        words = describe_spring(Connection(1, motor, "back"), found)
        assert words.startswith(f"spring {motor} on the back face, between masses {a} and {b} (")
        assert end in words
    assert describe_spring(Connection(3, 1, "front"), None) == "spring 1 on the front face"
    assert describe_spring(Connection(2, 1, "both"), None) == "spring 1 on both faces"
