# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Watches the heartbeats of the nodes."""

from __future__ import annotations

PERIOD = 0.2
"""Interval of the heartbeats [s]."""
CLIENT_PATIENCE = 0.75
"""The client of a run counts as gone after this time without a heartbeat: everything is off within a second
[s]."""
NODE_PATIENCE = 5.0
"""Another node counts as dead after this time without a heartbeat. Without it data are lost; those who heat
are watched by others, and more closely [s]."""


class Heartbeats:
    """When each node was last heard, on a monotonic clock."""

    def __init__(self, patience: float = NODE_PATIENCE):
        self._patience = patience
        self._heard: dict[str, tuple[float, str]] = {}

    def hear(self, name: str, state: str, now: float) -> None:
        """A heartbeat at `now` [s]. A node in the state `finalized` has shut down and is not missed."""
        if state == "finalized":
            self._heard.pop(name, None)
        else:
            self._heard[name] = (now, state)

    def silent(self, now: float) -> tuple[str, ...]:
        """Nodes that sent heartbeats and do not any more."""
        heard = list(self._heard.items())  # another thread may add a node
        return tuple(n for n, (t, _) in heard if now - t > self._patience)

    def forget(self, name: str) -> None:
        """Do not report this node as silent again before its next heartbeat."""
        self._heard.pop(name, None)

    def missing(self, required: tuple[str, ...], now: float) -> tuple[str, ...]:
        """Required nodes that are not active, each with its state."""
        states = {name: self.state_of(name, now) for name in required}
        return tuple(f"{name} is {state}" for name, state in states.items() if state != "active")

    def state_of(self, name: str, now: float) -> str:
        """The state that a node sent last; `silent` if that is too long ago, `absent` if it sent none."""
        heard, state = self._heard.get(name, (now, "absent"))
        return state if now - heard <= self._patience else "silent"
