# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Nodes in a process: spun until SIGINT or SIGTERM, then shut down with everything off."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from eldir.errors import EldirError
from eldir_ros.base.joining import joining
from eldir_ros.base.node_log import forward_records

_POLL = 0.2  # until a node notices that it has shut down [s]
_NOTICE = 0.05  # until a signal is noticed; one that another thread receives does not end the waiting [s]
_THREADS = 32  # at most, for each node: more than it has callback groups, so that none waits for a thread
LAUNCHER = "ELDIR_LAUNCHER"
"""Environment variable with the number of the process without which the nodes end: that of `ros2 launch`."""


def spin(classes: Sequence[Callable[[], Node]]) -> None:
    """Run nodes in this process until SIGINT or SIGTERM; the first one in the list is shut down first.

    ROS's own signal handlers would end the graph at once. Here each node can still publish how it ended.
    """
    ended, left, failures = threading.Event(), threading.Event(), list[str]()
    asked: list[int] = []
    launcher = os.environ.get(LAUNCHER, "")
    for number in (signal.SIGINT, signal.SIGTERM):
        # An event has a lock, which this very thread may hold when the signal comes.
        signal.signal(number, lambda number, _: asked.append(number))
    nodes: list[Node] = []
    executors: list[tuple[MultiThreadedExecutor, threading.Thread]] = []
    try:
        with joining():
            rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        for node_class in classes:
            with joining():
                nodes.append(node_class())
            if len(nodes) == 1:
                forward_records(nodes[0].get_name(), nodes[0].get_logger())
            executor = MultiThreadedExecutor(_THREADS)
            executor.add_node(nodes[-1])
            spinning = threading.Thread(target=_spin, args=(executor, left, ended, failures))
            spinning.start()
            executors.append((executor, spinning))
        while not asked and not ended.wait(_NOTICE):
            if launcher and launcher != str(os.getppid()):
                nodes[0].get_logger().error("the program that launched this node has gone: the node ends")
                break
    except (EldirError, ParameterException) as error:
        failures.append(str(error))
    finally:
        for node in nodes:
            node.shut_down()
        left.set()
        for executor, spinning in executors:
            spinning.join()
            executor._executor.shutdown()  # callbacks that have begun: rclpy's own shutdown waits for none
            executor.shutdown(timeout_sec=1.0)
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    for number in (signal.SIGINT, signal.SIGTERM):  # a second signal has no effect
        signal.signal(number, signal.SIG_IGN)
    if failures:
        sys.exit("; ".join(failures))


def _spin(
    executor: MultiThreadedExecutor, left: threading.Event, ended: threading.Event, failures: list[str]
) -> None:
    """Run one node's callbacks until it has shut down; a callback that fails ends the process in order."""
    try:
        while not left.is_set():
            executor.spin_once(timeout_sec=_POLL)
    except ExternalShutdownException:
        pass
    except Exception as error:
        failures.append(f"{type(error).__name__}: {error}")
    ended.set()
