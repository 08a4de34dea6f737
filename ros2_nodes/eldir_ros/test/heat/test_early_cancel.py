# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""A client may cancel as soon as its goal was accepted, before the sequencer has begun it."""

import threading

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from graph import PATIENCE, Graph, wait_until  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from schedules import CONFIG, LONG  # noqa: E402

from eldir_ros.base.waiting_executor import WaitingExecutor  # noqa: E402
from eldir_ros.conversions import runs  # noqa: E402
from eldir_ros.nodes.actuation_sequencer import ActuationSequencerNode  # noqa: E402


class LateSequencer(ActuationSequencerNode):
    """Begins a goal only after its cancellation has come, as a sequencer on a busy computer may."""

    def __init__(self, **options):
        self.is_cancelled = threading.Event()
        super().__init__(**options)

    def _start_goal(self, goal):
        assert self.is_cancelled.wait(PATIENCE)
        super()._start_goal(goal)

    def _cancel(self, goal):
        response = super()._cancel(goal)
        self.is_cancelled.set()
        return response


@pytest.fixture
def rig(tmp_path):
    """A relay board in a process of its own, and the late sequencer in this one."""
    with Graph(tmp_path, ("relay_board",)) as graph:
        context, errors, is_over = Context(), [], threading.Event()
        rclpy.init(domain_id=graph.domain, context=context)
        values = [Parameter("rig", value=str(CONFIG / "rig.yaml")), Parameter("autostart", value=True)]
        sequencer = LateSequencer(context=context, parameter_overrides=values)
        executor = WaitingExecutor(sequencer, 32, errors.append)

        def spin():
            while not is_over.is_set():
                executor.spin_once(timeout_sec=0.1)

        spinning = threading.Thread(target=spin)
        spinning.start()
        graph.ready()
        wait_until(lambda: sequencer.state == "active")
        yield graph, errors
        sequencer.shut_down()
        is_over.set()
        spinning.join()
        executor.finish()
        sequencer.destroy_node()
        context.try_shutdown()


def test_a_goal_that_is_cancelled_before_it_begins_does_not_heat(rig):
    graph, errors = rig
    goal = graph.send(LONG)
    cancelled = goal.cancel_goal_async()
    result = graph.result(goal)
    assert (result.outcome, result.all_off) == (runs.CANCELLED, True) and errors == []
    assert cancelled.done() and graph.edges() == [], "nothing was heated"
