# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Heat on a real graph of processes: begun, watched, and off in every way it can end.

Instants of switching are those of the emulated board's contacts, on the monotonic clock.
"""

import os
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from graph import NODES, Graph, wait_until  # noqa: E402
from schedules import LONG, SHORT  # noqa: E402

from eldir_hardware.realtime import COMMANDS, request_realtime_priority  # noqa: E402
from eldir_ros.conversions import runs  # noqa: E402
from eldir_ros.remote.graph_check import OBSERVERS  # noqa: E402
from eldir_ros.remote.heartbeats import NODE_TIMEOUT  # noqa: E402

HEATING = ("relay_board", "actuation_sequencer")
FOUR_EDGES = [(1, False), (1, True), (2, False), (2, True)]


@pytest.fixture
def graph(tmp_path):
    with Graph(tmp_path, HEATING) as graph:
        graph.ready()
        yield graph


def test_a_schedule_is_played_to_its_end_with_feedback(graph):
    goal = graph.send(SHORT)
    result = graph.result(goal)
    assert (result.outcome, result.message, result.all_off) == (runs.FINISHED, "played to the end", True)
    edges = graph.edges()
    changes = [(channel, closed) for _, channel, closed in edges]
    assert (sorted(changes[:2]), sorted(changes[2:])) == ([(1, True), (2, True)], [(1, False), (2, False)])
    closed, opened = edges[0][0], edges[-1][0]
    assert opened - closed == pytest.approx(1.0, abs=0.1)
    reported = [(e.channel, e.closed) for e in result.edges]
    assert sorted(reported) == [(1, False), (1, True), (2, False), (2, True)]
    assert any(list(f.closed) == [1, 2] for f in graph.feedback)
    assert any((f.phase, f.cycle) == (f.COUNTING, 1) for f in graph.feedback)
    assert list(graph.feedback[0].latest_edge) == [], "nothing has switched yet"
    assert max(max(f.temperatures) for f in graph.feedback) > 30


def test_programs_that_heat_come_before_others_where_that_is_permitted(graph):
    with ThreadPoolExecutor(1) as thread:
        thread.submit(request_realtime_priority, COMMANDS).result()
        permitted = thread.submit(os.sched_getscheduler, 0).result()
    assert os.sched_getscheduler(graph.processes["virtual_bench"].pid) == permitted
    for name in HEATING:
        process = graph.processes[name].pid
        others = [
            int(number)
            for number in os.listdir(f"/proc/{process}/task")
            if os.sched_getscheduler(int(number)) != permitted
        ]
        # The numerical library starts its threads when it is imported; they have nothing to do here.
        assert process not in others and len(others) < os.cpu_count(), name


def test_cancelled_in_mid_heating_everything_is_off_within_half_a_second(graph):
    goal = graph.heating(LONG)
    asked = time.monotonic()
    cancelled = goal.cancel_goal_async()
    off = graph.all_off()
    print(f"cancel: off {off - asked:.3f} s after the request")
    graph.require_within(off - asked, 0.5)
    result = graph.result(goal)
    assert sorted((e.channel, e.closed) for e in result.edges) == FOUR_EDGES, "what was actually done"
    assert cancelled.done() and (result.outcome, result.all_off) == (runs.CANCELLED, True)
    assert graph.state("relay_board") == "active", "a cancelled run is no emergency"


def test_a_new_schedule_preempts_the_one_that_runs(graph):
    first = graph.heating(LONG)
    asked = time.monotonic()
    second = graph.send(SHORT)
    assert graph.result(first).outcome == runs.PREEMPTED
    off = max(t for t, _, closed in graph.edges() if not closed and t < asked + 1.0)
    graph.require_within(off - asked, 0.5)
    # The springs have not rested: the guardian refuses, and latches.
    result = graph.result(second)
    assert result.outcome == runs.STOPPED and "too little time to cool" in result.message


def test_the_emergency_stop_from_another_process_is_latched_until_reset(graph):
    goal = graph.heating(LONG)
    command = ["ros2", "service", "call", "/emergency_stop", "std_srvs/srv/Trigger"]
    asked = time.monotonic()
    done = subprocess.run(command, env=graph.environment, capture_output=True, timeout=30, check=True)
    off = graph.all_off()
    print(f"emergency stop: off {off - asked:.3f} s after `ros2 service call` was started")
    assert b"success=True" in done.stdout and off - asked < 15.0  # the command itself takes its time to start
    result = graph.result(goal)
    assert result.outcome == runs.STOPPED and "emergency stop" in result.message
    assert result.all_off and sorted((e.channel, e.closed) for e in result.edges) == FOUR_EDGES
    wait_until(lambda: graph.state("relay_board") == "unconfigured", 5)
    refused = graph.result(graph.send(LONG))
    assert refused.outcome == runs.REFUSED and "latched" in refused.message
    assert graph.configure("relay_board") and not graph.activate("relay_board"), "latched"
    time.sleep(1.0)
    assert (graph.stops[-1].stopped, graph.stops[-1].reason) == (True, "the emergency stop was called")
    assert graph.state("relay_board") == "inactive", "a refused activation is no fault of the guardian"
    assert graph.call("reset_emergency_stop").success
    assert graph.configure("relay_board") and graph.activate("relay_board")
    time.sleep(8.0)  # the springs rest
    assert graph.result(graph.send(SHORT)).outcome == runs.FINISHED


def test_the_emergency_stop_called_on_the_graph_takes_effect_at_once(graph):
    graph.heating(LONG)
    asked = time.monotonic()
    assert graph.call("emergency_stop").success
    off = graph.all_off()
    print(f"emergency stop: off {off - asked:.3f} s after the call")
    graph.require_within(off - asked, 0.5)


@pytest.mark.parametrize("name", HEATING)
def test_deactivated_in_mid_heating_everything_is_off(graph, name):
    graph.heating(LONG)
    asked = time.monotonic()
    assert graph.deactivate(name)
    off = graph.all_off()
    print(f"{name} deactivated: off {off - asked:.3f} s after the call")
    graph.require_within(off - asked, 0.5)
    time.sleep(1.0)  # longer than the relay board waits for commands
    assert not any(s.stopped for s in graph.stops), "what is switched off in order is no emergency"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", HEATING)
def test_a_signal_leaves_everything_off(graph, name, number):
    graph.heating(LONG)
    asked = time.monotonic()
    graph.processes[name].send_signal(number)
    off = graph.all_off()
    print(f"{name} {number.name}: off {off - asked:.3f} s after the signal")
    graph.require_within(off - asked, 1.0)
    assert graph.processes[name].wait(10) == 0


@pytest.mark.parametrize("name", HEATING)
def test_a_node_that_hangs_in_mid_heating_does_not_heat_on(graph, name):
    graph.heating(LONG)
    asked = time.monotonic()
    graph.processes[name].send_signal(signal.SIGSTOP)
    off = graph.all_off()
    graph.processes[name].send_signal(signal.SIGCONT)
    print(f"{name} hung: off {off - asked:.3f} s later")
    graph.require_within(off - asked, 1.0)


def test_killing_any_node_leaves_everything_off_and_the_others_say_so(tmp_path):
    for victim in NODES:
        folder = tmp_path / victim
        folder.mkdir()
        with Graph(folder) as graph:
            graph.ready()
            goal = graph.heating(LONG)
            killed = time.monotonic()
            os.kill(graph.processes[victim].pid, signal.SIGKILL)
            off = graph.all_off()
            print(f"kill -9 {victim}: off {off - killed:.3f} s later")
            if victim in HEATING:
                graph.require_within(off - killed, 1.0)
            others = [n for n in NODES if n != victim]
            wait_until(
                lambda g=graph, v=victim, o=others: all(
                    f"{v} sends no heartbeats any more" in g.said(n) for n in o
                ),
                NODE_TIMEOUT + 10,
            )
            wait_until(
                lambda g=graph, v=victim: any(
                    v in s.message and s.level == b"\x02" for s in list(g.diagnostics)
                ),
                5,
            )
            if victim != "actuation_sequencer":
                result = graph.result(goal)
                assert result.outcome == runs.STOPPED and victim in result.message.replace(
                    "relay board", "relay_board"
                )
            assert graph.state("relay_board" if victim != "relay_board" else OBSERVERS[0]) != "finalized"


def test_killing_the_guardian_leaves_everything_off(graph):
    goal = graph.heating(LONG)
    parent = graph.processes["relay_board"].pid
    found = subprocess.run(["pgrep", "-P", str(parent)], capture_output=True, text=True, check=True)
    killed = time.monotonic()
    for child in found.stdout.split():
        os.kill(int(child), signal.SIGKILL)
    off = graph.all_off()
    print(f"kill -9 of the guardian: off {off - killed:.3f} s later")
    graph.require_within(off - killed, 1.0)
    wait_until(lambda: "guardian" in graph.said("relay_board"), 5)
    result = graph.result(goal)
    assert result.outcome == runs.STOPPED and "guardian" in result.message and result.all_off
    assert sorted((e.channel, e.closed) for e in result.edges) == FOUR_EDGES
    assert "guardian" in graph.stops[-1].reason
