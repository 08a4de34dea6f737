"""Nodes in a process: spun until SIGINT or SIGTERM, then put away with everything off."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from eldir.errors import EldirError

_GLANCE = 0.2  # how soon it is heeded that it is time to end [s]
_THREADS = 4  # for each node: commands, the action, its cancellation, beats


def spin(makers: Sequence[Callable[[], Node]]) -> None:
    """Run nodes in this process until it is told to end; the first that was made leaves first.

    ROS's own handlers would take the graph away at once: here nodes can still say how it ended.
    """
    ended, left, failures = threading.Event(), threading.Event(), list[str]()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    nodes: list[Node] = []
    executors: list[tuple[MultiThreadedExecutor, threading.Thread]] = []
    try:
        for maker in makers:
            nodes.append(maker())
            executor = MultiThreadedExecutor(_THREADS)
            executor.add_node(nodes[-1])
            spinning = threading.Thread(target=_spin, args=(executor, left, ended, failures))
            spinning.start()
            executors.append((executor, spinning))
        while not ended.wait(_GLANCE):  # a signal that another thread receives does not end the waiting
            pass
    except EldirError as error:
        failures.append(str(error))
    finally:
        for node in nodes:
            node.leave()
        left.set()
        for executor, spinning in executors:
            spinning.join()
            executor.shutdown(timeout_sec=1.0)
        rclpy.try_shutdown()
    for number in (signal.SIGINT, signal.SIGTERM):  # a second one changes nothing any more
        signal.signal(number, signal.SIG_IGN)
    if failures:
        sys.exit("; ".join(failures))


def _spin(
    executor: MultiThreadedExecutor, left: threading.Event, ended: threading.Event, failures: list[str]
) -> None:
    """One node's callbacks, until it has left; where they fail, the process ends, in order."""
    try:
        while not left.is_set():
            executor.spin_once(timeout_sec=_GLANCE)
    except ExternalShutdownException:
        pass
    except Exception as error:
        failures.append(f"{type(error).__name__}: {error}")
    ended.set()
