# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""An executor that waits for the callbacks that have begun before it ends."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any

from rclpy.executors import Executor, TimeoutException
from rclpy.node import Node


class WaitingExecutor(Executor):
    """Runs the callbacks of one node in a pool of threads.

    Unlike the MultiThreadedExecutor of Jazzy, `finish` waits for callbacks that have begun, so that a node is
    not destroyed under them.
    """

    def __init__(self, node: Node, threads: int, on_error: Callable[[Exception], None]):
        """`on_error` is called with the exception of a callback, in its thread."""
        super().__init__(context=node.context)
        self._callback_threads = ThreadPoolExecutor(threads)
        self._on_error, self._error_lock = on_error, Lock()
        self.add_node(node)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Begin the next callback that is ready; wait up to `timeout_sec` [s] for one."""
        try:
            task, _, _ = self.wait_for_ready_callbacks(timeout_sec=timeout_sec)
        except TimeoutException:
            return
        self._callback_threads.submit(self._run, task)

    def _run(self, task: Any) -> None:
        task()
        error = task.exception()
        if error is not None:
            with self._error_lock:
                self._on_error(error)

    def finish(self) -> None:
        """End after the callbacks that have begun; nobody may spin any more."""
        self._callback_threads.shutdown()
        self.shutdown(timeout_sec=1.0)
