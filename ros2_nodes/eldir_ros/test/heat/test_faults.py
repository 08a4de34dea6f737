# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Faults that are no heat: nodes that come back, parameters and messages that cannot be used."""

import math
import os
import signal
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from builtin_interfaces.msg import Time  # noqa: E402
from eldir_msgs.msg import EmergencyStop, HeatCommand, Pulse, RangeOfMotion, ReferenceTags, Run  # noqa: E402
from graph import PATIENCE, Graph, message_of, wait_until  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from schedules import LONG, SHORT  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from eldir_ros.base.qualities import COMPLETE, LATCHED  # noqa: E402
from eldir_ros.conversions import duration_of, marks, runs  # noqa: E402
from eldir_ros.remote.heartbeats import NODE_TIMEOUT  # noqa: E402

HEATING = ("relay_board", "actuation_sequencer")
READERS = ("mass_tracker", "mcap_recorder", "range_of_motion")
SILENT = "actuation_sequencer sends no heartbeats any more"


def level(graph, name):
    """The latest state of a node in the diagnostics: its level and its message."""
    found = [s for s in list(graph.diagnostics) if s.name == f"{name}: state"]
    return (found[-1].level, found[-1].message) if found else (b"", "")


def test_a_node_that_is_back_is_no_error_any_more(tmp_path):
    with Graph(tmp_path, HEATING) as graph:
        graph.ready()
        graph.processes["actuation_sequencer"].send_signal(signal.SIGSTOP)
        wait_until(lambda: SILENT in level(graph, "relay_board")[1], NODE_TIMEOUT + 20)
        graph.processes["actuation_sequencer"].send_signal(signal.SIGCONT)
        wait_until(lambda: level(graph, "relay_board") == (b"\x00", "active"))


def test_a_recorder_that_is_late_ends_no_run(tmp_path):
    with Graph(tmp_path, (*HEATING, "mcap_recorder")) as graph:
        graph.ready()
        goal = graph.heating(SHORT)
        graph.processes["mcap_recorder"].send_signal(signal.SIGSTOP)
        time.sleep(2.0)
        graph.processes["mcap_recorder"].send_signal(signal.SIGCONT)
        result = graph.result(goal)
        assert result.outcome == runs.FINISHED, result.message


def test_a_whole_number_is_a_number_and_what_is_none_is_one_line(tmp_path):
    with Graph(tmp_path, ()) as graph:
        for lead, why in ((99.0, "expected a number from 0.5 to 30"), ("soon", "found 'soon'")):
            assert graph.start("actuation_sequencer", lead_s=lead).wait(60) == 1
            assert why in graph.said("actuation_sequencer")
        assert graph.start("actuation_sequencer", lead=2.0).wait(60) == 1
        assert "expected lead_s; found lead: 2.0" in graph.said("actuation_sequencer"), "ROS would ignore it"
        assert graph.start("actuation_sequencer", rig=5).wait(60) == 1
        graph.start("actuation_sequencer", lead_s=2)
        assert graph.configure("actuation_sequencer")
        assert "Traceback" not in graph.said("actuation_sequencer")


def test_damaged_messages_end_no_node(tmp_path):
    with Graph(tmp_path, READERS) as graph:
        graph.ready()
        tags = graph.node.create_publisher(ReferenceTags, "camera/tags", LATCHED)
        run = graph.node.create_publisher(Run, "run", LATCHED)
        wrong = message_of(LONG)
        wrong.events[0].face = 9
        for schedule in (Run().schedule, wrong):
            tags.publish(ReferenceTags(dictionary="none", side=math.nan))
            run.publish(Run(state=Run.RUNNING, id="x", schedule=schedule))
            time.sleep(0.5)
        for name in READERS:
            assert graph.state(name) == "active" and graph.processes[name].poll() is None
        wait_until(lambda: level(graph, "range_of_motion")[0] == b"\x02", 5)


def test_a_prediction_that_was_killed_is_told_and_holds_no_node_up(tmp_path):
    """SIGTERM for a whole process group, as `timeout` and service managers send it, reaches it too."""
    with Graph(tmp_path, (*HEATING, "range_of_motion")) as graph:
        graph.ready()
        goal = graph.heating(SHORT)
        node = graph.processes["range_of_motion"]
        wait_until(lambda: children(node.pid))
        for child in children(node.pid):
            os.kill(child, signal.SIGTERM)
        wait_until(
            lambda: "the prediction failed: its process was ended" in level(graph, "range_of_motion")[1], 10
        )
        assert graph.result(goal).outcome == runs.FINISHED
        node.terminate()
        assert node.wait(PATIENCE) == 0


@pytest.mark.parametrize("stopped", [False, True])
def test_a_run_that_ended_early_has_no_further_cycles(tmp_path, stopped):
    """Its marks still arrive, and no other run has begun."""
    names, heights = ("m1", "m2", "m3", "m4", "m5"), np.linspace(0.0, 0.2, 5)
    schedule, ranges = message_of({**LONG, "cycles": 3}), []
    with Graph(tmp_path, ("range_of_motion",)) as graph:
        graph.ready()
        publish, node = graph.node.create_publisher, graph.processes["range_of_motion"].pid
        run, stop = publish(Run, "run", LATCHED), publish(EmergencyStop, "emergency_stop", LATCHED)
        seen = publish(MarkerArray, "marks", COMPLETE)
        graph.node.create_subscription(RangeOfMotion, "range_of_motion", ranges.append, LATCHED)
        wait_until(
            lambda: seen.get_subscription_count() and graph.node.count_publishers("range_of_motion"), 20
        )

        def show(begin, end):
            for t in np.arange(begin, end, 0.5):
                places = np.column_stack([heights, heights + 0.01 * np.sin(t)])
                seen.publish(marks.markers_of(round(1e9 * t), names, places))

        run.publish(Run(state=Run.RUNNING, id="a", schedule=schedule))
        hold_prediction(node)  # it began, so the node has heard of the run; its end will tell that of the end
        show(0.0, 21.0)
        wait_until(lambda: [r.cycle for r in ranges] == [1])
        if stopped:  # by a relay board whose sequencer has died, and tells nothing
            stop.publish(EmergencyStop(stopped=True, reason="tried"))
        else:
            run.publish(Run(state=Run.ENDED, id="a", schedule=schedule))
        wait_until(lambda: not children(node))
        show(21.0, 42.0)
        time.sleep(2.0)  # for a second cycle to be told, as it would be without the end
        run.publish(Run(state=Run.RUNNING, id="b", schedule=schedule, start=Time(sec=100)))
        hold_prediction(node)
        show(100.0, 121.0)
        wait_until(lambda: len(ranges) > 1)
        assert [(r.cycle, r.header.stamp.sec) for r in ranges] == [(1, 20), (1, 120)]


def hold_prediction(node):
    """Wait for the prediction of a run, and stop it: it then ends only when the node ends it. A child that
    has no lower priority yet is still being told what to compute, and the node would wait for it."""

    def predictions():
        own = os.getpriority(os.PRIO_PROCESS, node)
        return [child for child in children(node) if os.getpriority(os.PRIO_PROCESS, child) > own]

    wait_until(predictions)
    for child in predictions():
        os.kill(child, signal.SIGSTOP)


def children(process):
    """Processes that a process has started, its helper for shared memory left out."""
    found: list[int] = []
    for thread in Path(f"/proc/{process}/task").iterdir():
        with suppress(OSError):  # the thread has ended meanwhile; another one has its children now
            found += map(int, (thread / "children").read_text().split())
    return [n for n in found if b"resource_tracker" not in command_of(n)]


def command_of(process):
    """The command line of a process; empty if it is gone."""
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


@pytest.mark.parametrize(
    "damage",
    [
        {"pulses": [(1, 1.0), (1, 2.0)]},
        {"pulses": [(1, 1.0)], "delay": 5.0},
        {"pulses": [(1, -1.0)]},
        {"pulses": [(1, 1.0)], "sequence": 0},
        {"command": HeatCommand.UNKNOWN},
    ],
    ids=["one channel twice", "far ahead", "negative", "unnumbered", "no command"],
)
def test_a_damaged_command_heats_nothing_and_stops_the_rig(tmp_path, damage):
    with Graph(tmp_path, ("relay_board",)) as graph:
        graph.ready()
        commands = graph.node.create_publisher(HeatCommand, "relay_board/commands", COMPLETE)
        wait_until(lambda: commands.get_subscription_count() > 0, 10)
        fields = {"command": HeatCommand.PULSES, "sequence": 1, "delay": 0.0, "pulses": ()} | damage
        fields["delay"] = duration_of(fields["delay"])
        fields["pulses"] = [Pulse(channel=c, duration=duration_of(s)) for c, s in fields["pulses"]]
        commands.publish(HeatCommand(run="x", **fields))
        wait_until(lambda: graph.state("relay_board") == "unconfigured", 10)
        assert graph.edges() == [] and graph.processes["relay_board"].poll() is None
        assert "a command of run 'x' is damaged" in graph.stops[-1].reason


def test_the_relay_board_waits_for_its_port(tmp_path):
    with Graph(tmp_path, ()) as graph:
        graph.start("relay_board", port=tmp_path / "later", autostart=True)
        wait_until(lambda: "waiting for the relay board's port" in graph.said("relay_board"), 30)
        wait_until(lambda: level(graph, "relay_board")[0] == b"\x01", 10)
        graph.request("relay_board", Transition.TRANSITION_ACTIVATE)  # it has no such transition
        wait_until(lambda: "Transition is not registered" in graph.said("relay_board"), 10)
        (tmp_path / "later").symlink_to((tmp_path / "board").resolve())
        wait_until(lambda: graph.state("relay_board") == "active", 30)
        assert "cannot open" not in graph.said("relay_board")
