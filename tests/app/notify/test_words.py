"""A word when a run ends, is stopped, or loses its camera: from real runs to real receivers."""

import json
import os
import signal
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.drive import to_dry_run
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.schedule import ActuationSchedule, Event
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.app.notify.receivers import camera, mute, receiver
from tests.app.watch.bench import ELDIR, again_where_busy, heating, save_schedule
from tests.forked_programs import finished
from tests.hardware.emulated_rigs import emulated, rig_file, wait
from tests.hardware.rigs_and_schedules import rig_text
from tests.hardware.run.faults import guardian_of
from tests.hardware.vision.walking_films import SPACE, film

PERIOD = 1.6
SECRET = "pw-Zk3"


def drive(folder, rig, *more):
    words = [str(folder / "schedule.json"), "--rig", str(rig), "--log", str(folder / "log.mcap"), *more]
    return finished([*ELDIR, "rig", "drive", *words])


def virtual(folder, *addresses):
    """A virtual rig without robot and camera in virtual time, and its schedule."""
    rig = folder / "rig.yaml"
    text = "\n".join(line for line in rig_text().splitlines() if not line.startswith("camera"))
    rig.write_text(f"{text}\nnotify: {json.dumps(addresses)}\n")
    save_schedule(rig, folder / "schedule.json")
    return rig


def test_a_run_that_has_finished_is_told_and_no_log_has_the_address(tmp_path):
    with receiver() as (address, words):
        secret = address.replace("json://", f"json://lab:{SECRET}@")
        rig = virtual(tmp_path, secret)
        said = drive(tmp_path, rig)
        assert said.returncode == 0, said.stderr
        ((_, word),) = words
    assert to_dry_run(Rig.load(rig)).notify == (), "a dry run tells nobody"
    assert word.startswith("virtual bench: finished | log.mcap: played to the end: 100 s, highest modelled")
    with (tmp_path / "log.mcap").open("rb") as log:
        files = {a.name: a.data for a in make_reader(log).iter_attachments()}
    assert b"notify: ['json://hidden']" in files["rig.yaml"]
    assert SECRET not in said.stdout + said.stderr + "".join(f.decode() for f in files.values())


@pytest.mark.parametrize("how", ["off while suspended", "killed"])
@again_where_busy
def test_a_stop_and_its_reason_are_told(how, tmp_path):
    with receiver() as (address, words), heating(tmp_path / "run", notify=[address]) as run:
        if how == "killed":
            run.player.kill()
            assert wait(lambda: words)
            why = "the driving program has died. The stop is latched (the program that heats has died)"
        else:
            for process in (guardian_of(run.board), run.player.pid):
                os.kill(process, signal.SIGSTOP)
            subprocess.run([*ELDIR, "rig", "off", "--rig", str(run.rig)], capture_output=True, check=True)
            assert wait(lambda: words)
            assert words.pop(0)[1] == (
                "bench of run: stop latched | "
                "log.mcap: stopped by eldir rig off. To heat again: eldir rig reset"
            )
            os.kill(run.player.pid, signal.SIGCONT)
            assert wait(lambda: words)
            why = "the guardian died (stopped by eldir rig off); all contacts are open"
        ((_, word),) = words
        assert word.startswith("bench of run: stopped | log.mcap: after ") and why in word, word


def test_a_lost_camera_is_told_while_it_heats_and_a_mute_address_moves_no_edge(tmp_path):
    """The word is sent in the middle of the run; one address never answers, one refuses, one is none."""
    eyes = VirtualCamera(7, SPACE)
    (_, image), *_ = film(eyes, np.array([0.0]))
    picture = cv2.imencode(".jpg", image)[1].tobytes()
    (tmp_path / "tags.json").write_text(json.dumps(eyes.board.to_json()))
    pulses = (Event(0.0, 0, "front", 1, True), Event(0.5, 0, "front", 1, False))
    with (
        receiver() as (good, words),
        receiver(500) as (refusing, _),
        mute() as silent,
        camera(picture, 3.0) as device,
        emulated("lcus") as board,
    ):
        addresses = [good, silent, refusing, f"jsonn://lab:{SECRET}@h/"]
        rig = rig_file(
            tmp_path / "rig.yaml", "lcus", board.port,
            supply={"voltage_v": 11, "current_limit_a": 1.0, "max_total_current_a": 16},
            limits={"max_temperature_c": 90, "max_on_s": 6.0, "min_off_s": 0.5},
            camera={"kind": "live", "device": device, "tags": "tags.json", "rate_hz": 10},
            notify=addresses,
        )  # fmt: skip
        plan = ActuationSchedule(
            PERIOD, events=pulses, cycles=6, conditioning_cycles=0, settle_s=0.3, springs=(7,)
        )
        with_digests(plan, Rig.load(rig)).save(tmp_path / "schedule.json")
        begun = time.monotonic()
        said = drive(tmp_path, rig)
        took = time.monotonic() - begun
        closed = np.array([edge.t for edge in board.contact_events if edge.closed])
    assert len(words) == 2, said.stderr
    lost, ended = words
    assert lost[1].startswith("virtual bench: camera lost | log.mcap: no frame since ")
    assert "the heating goes on" in lost[1] and closed[-1] > lost[0], "it heats after that word"
    assert "stopped | " in ended[1] and "gives no picture any more" in ended[1]
    assert len(closed) == 6
    # Waiting for an address would cost seconds; a tenth may pass where other tests compute beside this one.
    assert abs(np.diff(closed) - PERIOD).max() < 0.5, np.diff(closed)
    assert took < 30.0, took  # the mute address is given up
    notes = [line for line in said.stderr.splitlines() if line.startswith("eldir: notification not sent")]
    assert [line.split(" of notify ")[1].split(":")[0] for line in notes] == [
        "did not answer within 10 s",
        "refused the notification",
        "is unknown to apprise",
    ]
    assert SECRET not in said.stdout + said.stderr


def test_the_doctor_finds_a_wrong_address(tmp_path):
    with receiver() as (good, words), receiver(403) as (refusing, _):
        rig = virtual(tmp_path, good, refusing, f"jsonn://lab:{SECRET}@h/")
        said = finished([*ELDIR, "rig", "doctor", "--rig", str(rig)])
    assert [word for _, word in words] == ["virtual bench: a test | eldir rig doctor checks this address"]
    assert said.returncode == 1 and SECRET not in said.stdout + said.stderr
    for line in (
        "ok    notify: address 1 (json) accepted a test notification",
        "FAIL  notify: address 2 (json) refused the notification; correct it in the rig file",
        "FAIL  notify: address 3 (jsonn) is unknown to apprise; correct it in the rig file",
    ):
        assert line in said.stdout


def test_without_apprise_the_run_goes_on_and_says_so(tmp_path):
    rig = virtual(tmp_path, "json://127.0.0.1:9/")
    program = "import sys; sys.modules['apprise'] = None; from eldir_app.main import main; main()"
    words = ["rig", "drive", tmp_path / "schedule.json", "--rig", rig, "--log", tmp_path / "log.mcap"]
    said = finished([sys.executable, "-c", program, *map(str, words)])
    assert said.returncode == 0, said.stderr
    assert (
        "eldir: notifications are not sent: apprise is not installed: pip install 'eldir[notify]'"
        in said.stderr
    )
