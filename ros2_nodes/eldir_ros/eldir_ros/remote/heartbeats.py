# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Watches the heartbeats of the nodes."""

from __future__ import annotations

PERIOD = 0.2
"""Interval of the heartbeats [s]."""
CLIENT_TIMEOUT = 0.75
"""The client of a run counts as gone after this time without a heartbeat, so that everything is off within a
second [s]."""
NODE_TIMEOUT = 5.0
"""Another node counts as dead after this time without a heartbeat. Its absence costs only data; nodes that
heat have shorter timeouts elsewhere [s]."""


class Heartbeats:
    """The last heartbeat of each node, on a monotonic clock."""

    def __init__(self, timeout: float = NODE_TIMEOUT):
        self._timeout = timeout
        self._last: dict[str, tuple[float, str]] = {}

    def update(self, name: str, state: str, now: float) -> None:
        """Record a heartbeat at `now` [s]. A node in the state `finalized` has shut down and is not reported
        as silent."""
        if state == "finalized":
            self._last.pop(name, None)
        else:
            self._last[name] = (now, state)

    def silent(self, now: float) -> tuple[str, ...]:
        """Nodes whose heartbeats have stopped."""
        known = list(self._last.items())  # another thread may add a node
        return tuple(n for n, (t, _) in known if now - t > self._timeout)

    def forget(self, name: str) -> None:
        """Do not report this node as silent again before its next heartbeat."""
        self._last.pop(name, None)

    def missing(self, required: tuple[str, ...], now: float) -> tuple[str, ...]:
        """Required nodes that are not active, each with its state."""
        states = {name: self.state_of(name, now) for name in required}
        return tuple(f"{name} is {state}" for name, state in states.items() if state != "active")

    def state_of(self, name: str, now: float) -> str:
        """The last state of a node; `silent` if its heartbeats have stopped, `absent` if it sent none."""
        last, state = self._last.get(name, (now, "absent"))
        return state if now - last <= self._timeout else "silent"
