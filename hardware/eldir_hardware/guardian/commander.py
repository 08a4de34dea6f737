"""Decides who may heat: one commander at a time, which must send commands again and again."""

from __future__ import annotations

PATIENCE = 0.6
"""A commander counts as lost after this time without a command [s]."""


class Commander:
    """The run that heats, if one does. Times are those of one monotonic clock [s]."""

    def __init__(self, patience: float = PATIENCE):
        self.name = ""
        """The run that heats; empty where none does."""
        self._patience = patience
        self._heard = 0.0

    def accepts(self, name: str) -> bool:
        """Whether a command of this run may be obeyed: no other run heats."""
        return self.name in ("", name)

    def hear(self, name: str, now: float) -> None:
        """A command that keeps the heat alive has come."""
        self.name, self._heard = name, now

    def release(self) -> None:
        """No run heats any more."""
        self.name = ""

    def lost_for(self, now: float) -> float | None:
        """Time without a command of the run that heats [s], if it is too long; otherwise None."""
        silent = now - self._heard
        return silent if self.name and silent > self._patience else None
