# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Two rigs on one graph, each in its namespace; and a clock that is not the machine's."""

import threading
import time

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from graph import NODES, Graph, is_busy, wait_until  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from schedules import LONG, MIDDLE, SHORT  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from eldir_ros.base.qualities import COMPLETE  # noqa: E402
from eldir_ros.conversions import runs, seconds_from  # noqa: E402

HEATING = ("relay_board", "actuation_sequencer")
SHARED = {"/diagnostics", "/parameter_events", "/rosout", "/tf", "/tf_static"}
"""Topics that all rigs of a graph have in common, as every ROS program does."""


@pytest.fixture
def rigs(tmp_path):
    for name in ("left", "right"):
        (tmp_path / name).mkdir()
    with (
        Graph(tmp_path / "left", NODES, "left") as left,
        Graph(tmp_path / "right", HEATING, "right", beside=left) as right,
    ):
        left.ready()
        right.ready()
        yield left, right


def diagnosed(graph):
    """Exit status and output of the doctor."""
    before = graph.said("doctor") if (graph.folder / "doctor.txt").exists() else ""
    status = graph.start("doctor").wait(60)
    return status, graph.said("doctor").removeprefix(before)


def test_two_rigs_on_one_graph_know_nothing_of_each_other(rigs):
    left, right = rigs
    status, lines = diagnosed(left)
    failed = [line for line in lines.splitlines() if line.startswith("FAIL")]
    if is_busy():
        failed = [line for line in failed if not line.startswith("FAIL  pictures")]
    assert not failed, lines
    assert f"ok    graph: domain {left.domain}, localhost, namespace /left" in lines
    status, lines = diagnosed(right)
    assert status == 1 and "FAIL  mass_tracker: is not running" in lines and "FAIL  pictures: 0.0" in lines
    frames = set()
    left.node.create_subscription(
        MarkerArray, "marks", lambda m: frames.update(k.header.frame_id for k in m.markers), COMPLETE
    )
    ends = right.send(MIDDLE)
    stopped = left.heating(LONG)
    topics = {name for name, _ in left.node.get_topic_names_and_types()}
    foreign = {t for t in topics - SHARED if not t.startswith(("/left/", "/right/"))}
    assert not foreign, "a name is not relative"
    asked = time.monotonic()
    assert left.call("emergency_stop").success
    left.require_within(left.all_off() - asked, 0.5)
    assert left.result(stopped).outcome == runs.STOPPED
    result = right.result(ends)
    held_up = f"this process was held up for {right.stalls.worst:.2f} s"
    assert (result.outcome, result.message) == (runs.FINISHED, "played to the end"), held_up
    assert len(right.edges()) == 4 and right.edges()[-1][0] > asked, "it heated on after the other's stop"
    status, lines = diagnosed(left)
    assert status == 1 and "FAIL  emergency stop: latched: the emergency stop was called" in lines
    assert right.state("relay_board") == "active" and not any(s.stopped for s in right.stops)
    wait_until(lambda: frames)
    assert frames == {"left/ground"}
    wait_until(lambda: any(s.name == "/left/relay_board: state" for s in list(right.diagnostics)), 10)


@pytest.mark.parametrize("wrong", HEATING)
@pytest.mark.parametrize(("ahead", "speed"), [(5.0, 1.0), (-5.0, 1.0), (0.0, 0.0), (0.0, 10.0)])
def test_a_clock_that_is_wrong_does_not_change_the_heat(tmp_path, wrong, ahead, speed):
    """One node's time of day is ahead, behind, still or fast: contacts close as long as they must."""
    with Graph(tmp_path, HEATING, simulated=(wrong,)) as graph:
        clock, begun = graph.node.create_publisher(Clock, "/clock", 1), time.time()
        over = threading.Event()

        def show():
            while not over.wait(0.05):
                message = Clock()
                seconds = begun + ahead + speed * (time.time() - begun)
                message.clock.sec, message.clock.nanosec = int(seconds), int(seconds % 1 * 1e9)
                clock.publish(message)

        showing = threading.Thread(target=show)
        showing.start()
        try:
            graph.ready()
            asked = time.monotonic()
            result = graph.result(graph.send(SHORT))
        finally:
            over.set()
            showing.join()
        assert (result.outcome, result.all_off) == (runs.FINISHED, True), result.message
        closed, opened = ([t for t, _, now in graph.edges() if now is state] for state in (True, False))
        print(f"{wrong} {ahead:+.0f} s, speed {speed:g}: closed for {max(opened) - min(closed):.3f} s")
        assert len(closed) == len(opened) == 2
        assert max(opened) - min(closed) == pytest.approx(1.0, abs=0.15 + graph.stalls.worst)
        assert min(closed) - asked < 5.0 + graph.stalls.worst, "at once, and not when the clocks agree"
        assert seconds_from(result.edges[0].elapsed) == pytest.approx(0.2, abs=0.4), "of the schedule's time"
