"""Watches the heartbeats of the nodes."""

from __future__ import annotations

PERIOD = 0.2
"""Interval of the heartbeats [s]."""
PATIENCE = 0.75
"""A node counts as dead after this time without a heartbeat [s]."""


class Heartbeats:
    """When each node was last heard, on a monotonic clock."""

    def __init__(self, patience: float = PATIENCE):
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
        return tuple(n for n, (t, _) in self._heard.items() if now - t > self._patience)

    def forget(self, name: str) -> None:
        """Do not report this node as silent again before its next heartbeat."""
        self._heard.pop(name, None)

    def missing(self, required: tuple[str, ...], now: float) -> tuple[str, ...]:
        """Required nodes that are not active, each with its state."""
        found = []
        for name in required:
            heard, state = self._heard.get(name, (-float("inf"), "absent"))
            if now - heard > self._patience:
                state = "silent" if name in self._heard else "absent"
            if state != "active":
                found.append(f"{name} is {state}")
        return tuple(found)
