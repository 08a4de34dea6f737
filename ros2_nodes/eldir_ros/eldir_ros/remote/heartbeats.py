"""Who has fallen silent, by their beats."""

from __future__ import annotations

PERIOD = 0.2
"""From one beat to the next [s]."""
PATIENCE = 0.75
"""Without a beat for so long, a node counts as dead [s]."""


class Heartbeats:
    """When each node was last heard, on a monotonic clock."""

    def __init__(self, patience: float = PATIENCE):
        self._patience = patience
        self._heard: dict[str, tuple[float, str]] = {}

    def hear(self, name: str, state: str, now: float) -> None:
        """A beat. Whoever says `finalized` has left and is missed by nobody."""
        if state == "finalized":
            self._heard.pop(name, None)
        else:
            self._heard[name] = (now, state)

    def silent(self, now: float) -> tuple[str, ...]:
        """Nodes that beat before and do not any more."""
        return tuple(n for n, (t, _) in self._heard.items() if now - t > self._patience)

    def forget(self, name: str) -> None:
        """Until it beats again."""
        self._heard.pop(name, None)

    def missing(self, wanted: tuple[str, ...], now: float) -> tuple[str, ...]:
        """Which of the wanted nodes are not active, each with what is known of it."""
        found = []
        for name in wanted:
            heard, state = self._heard.get(name, (-float("inf"), "absent"))
            if now - heard > self._patience:
                state = "silent" if name in self._heard else "absent"
            if state != "active":
                found.append(f"{name} is {state}")
        return tuple(found)
