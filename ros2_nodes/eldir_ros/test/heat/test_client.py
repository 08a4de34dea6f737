# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The client of a run on a real graph: whatever ends it ends the heat, and it says what it waits for."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from ament_index_python.packages import get_package_prefix  # noqa: E402
from eldir_msgs.action import RunSchedule  # noqa: E402
from graph import PATIENCE, Graph, message_of, wait_until  # noqa: E402
from schedules import CONFIG, LONG, SHORT  # noqa: E402

from eldir_ros.conversions import runs  # noqa: E402

HEATING = ("relay_board", "actuation_sequencer")


@pytest.fixture
def graph(tmp_path):
    (tmp_path / "schedule.json").write_text(json.dumps(LONG))
    with Graph(tmp_path, HEATING) as graph:
        graph.ready()
        yield graph


def heated_by(graph, start):
    """Start a client; returns it when a contact has just closed."""
    before = len(graph.edges())
    client = start()
    wait_until(
        lambda: client.poll() is not None or any(closed for _, _, closed in graph.edges()[before:]), 60
    )
    assert client.poll() is None
    time.sleep(0.3)
    return client


def off_after(graph, event, strike):
    asked = time.monotonic()
    strike()
    off = graph.all_off()
    print(f"{event}: off {off - asked:.3f} s later")
    graph.require_within(off - asked, 1.0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL, signal.SIGSTOP])
def test_the_heat_does_not_outlive_its_client(graph, number):
    client = heated_by(graph, lambda: graph.start("run_schedule", str(graph.folder / "schedule.json")))
    off_after(graph, f"run_schedule {number.name}", lambda: client.send_signal(number))
    if number == signal.SIGSTOP:
        client.send_signal(signal.SIGCONT)
    status = client.wait(PATIENCE)
    assert status == (-9 if number == signal.SIGKILL else 1), graph.said("run_schedule")
    assert graph.state("relay_board") == "active", "a client that goes is no emergency"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_the_heat_does_not_outlive_the_command_that_started_the_client(graph, number):
    command = ["ros2", "run", "eldir_ros", "run_schedule", str(graph.folder / "schedule.json")]
    start = lambda: subprocess.Popen(  # noqa: E731
        command, env=graph.environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    client = heated_by(graph, start)
    off_after(graph, f"ros2 run {number.name}", lambda: client.send_signal(number))
    client.wait(PATIENCE)


def test_a_client_of_any_kind_must_send_heartbeats(graph):
    goal = graph.heating(LONG)
    off_after(graph, "heartbeats end", lambda: setattr(graph, "beating", False))
    result = graph.result(goal)
    assert (result.outcome, result.all_off) == (runs.STOPPED, True)
    assert "the client tester sends no heartbeats any more" in result.message


def test_a_goal_without_a_client_or_of_nonsense_is_refused(graph):
    no_period, on_no_face = message_of(SHORT), message_of(SHORT)
    no_period.period.sec, no_period.period.nanosec = 0, 0
    on_no_face.events[0].face = 7
    for schedule, client, why in (
        (message_of(SHORT), "", "names no client"),
        (no_period, "tester", "period_s"),
        (on_no_face, "tester", "an event of the schedule is on no face"),
        (RunSchedule.Goal().schedule, "tester", "period_s"),
    ):
        sent = graph.order(RunSchedule.Goal(schedule=schedule, client=client))
        result = graph.result(sent)
        assert (result.outcome, result.all_off) == (runs.REFUSED, True) and why in result.message
    assert graph.edges() == []
    assert graph.result(graph.send(SHORT)).outcome == runs.FINISHED


def test_a_schedule_without_digests_needs_a_reason(graph):
    by_hand = message_of(SHORT | {"provenance": {}})
    refused = graph.result(graph.order(RunSchedule.Goal(schedule=by_hand, client="tester")))
    assert refused.outcome == runs.REFUSED and "it lacks the digests" in refused.message
    edited = message_of(SHORT)
    edited.cycles += 1
    refused = graph.result(graph.order(RunSchedule.Goal(schedule=edited, client="tester")))
    assert refused.outcome == runs.REFUSED and "it was edited" in refused.message and graph.edges() == []
    graph.processes["actuation_sequencer"].terminate()
    graph.processes["actuation_sequencer"].wait(PATIENCE)
    graph.start("actuation_sequencer", accept_mismatch="a plan of our own")
    assert graph.configure("actuation_sequencer") and graph.activate("actuation_sequencer")
    played = graph.result(graph.order(RunSchedule.Goal(schedule=by_hand, client="tester")))
    assert played.outcome == runs.FINISHED and len(graph.edges()) == 4, played.message


def test_while_a_stop_is_latched_the_client_names_it_at_once(graph):
    graph.heating(LONG)
    assert graph.call("emergency_stop").success
    client = graph.start("run_schedule", str(graph.folder / "schedule.json"))
    assert client.wait(40) == 1
    assert "the emergency stop is latched: the emergency stop was called" in graph.said("run_schedule")


def test_a_client_whose_sequencer_dies_ends(graph):
    client = heated_by(graph, lambda: graph.start("run_schedule", str(graph.folder / "schedule.json")))
    sequencer = graph.processes["actuation_sequencer"].pid
    off_after(graph, "kill -9 actuation_sequencer", lambda: os.kill(sequencer, signal.SIGKILL))
    assert client.wait(30) == 1
    said = graph.said("run_schedule")
    assert "emergency stop" in said or "actuation_sequencer is silent" in said


def test_a_graph_that_refuses_the_client_is_told_in_one_line(tmp_path, monkeypatch):
    """SROS 2 without keys for the enclave."""
    (tmp_path / "schedule.json").write_text(json.dumps(SHORT))
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path))
    monkeypatch.setenv("ROS_SECURITY_ENCLAVE_OVERRIDE", "/eldir/client")
    for program in ("run_schedule", "doctor", "relay_board"):
        command = Path(get_package_prefix("eldir_ros")) / "lib" / "eldir_ros" / program
        arguments = ["schedule.json"] if program == "run_schedule" else []
        done = subprocess.run(
            [command, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 1
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert "found enclave /eldir/client; name an enclave that may do it" in done.stderr


def test_a_foreign_client_of_thirty_lines_runs_a_schedule_watches_and_cancels(graph):
    """With generated messages only: `examples/foreign_client.py`."""
    client = str(CONFIG.parent / "examples" / "foreign_client.py")
    (graph.folder / "short.json").write_text(json.dumps(SHORT))
    command = [sys.executable, client, str(graph.folder / "short.json")]
    done = subprocess.run(
        command, env=graph.environment, capture_output=True, text=True, timeout=90, check=True
    )
    *feedback, last = done.stdout.splitlines()
    assert last == "played to the end True" and len(graph.edges()) == 4, done.stdout
    assert any(line.startswith("[1, 2] [") for line in feedback), "both contacts are closed"
    time.sleep(8.0)  # the springs rest
    command = [sys.executable, client, str(graph.folder / "schedule.json"), "4.0"]
    cancelled = heated_by(
        graph, lambda: subprocess.Popen(command, env=graph.environment, stdout=subprocess.PIPE)
    )
    said = cancelled.communicate(timeout=60)[0].decode().splitlines()
    assert said[-1] == "cancelled; everything was switched off True" and graph.all_off()
    assert sum(closed for _, _, closed in graph.edges()) == 4, "two contacts in each run"
