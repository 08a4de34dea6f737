"""Edges of the contacts in a run, by the board's reports."""

from __future__ import annotations

from typing import NamedTuple


class ContactEdge(NamedTuple):
    """A contact that closed or opened."""

    t: float
    """Seconds since the start of the schedule, of the report that first showed it."""
    channel: int
    """Number of the relay channel, from 1."""
    closed: bool


class ContactEdges:
    """Collects the edges between one report and the next."""

    def __init__(self) -> None:
        self.found: list[ContactEdge] = []
        self.closed: tuple[bool, ...] = ()
        """The latest report; empty before the first one."""

    def update(self, t: float, closed: tuple[bool, ...]) -> None:
        """Add a report of all contacts at `t` [s]; all are open before the first one."""
        before = self.closed or (False,) * len(closed)
        for channel, (was, now) in enumerate(zip(before, closed, strict=True), start=1):
            if was != now:
                self.found.append(ContactEdge(t, channel, now))
        self.closed = tuple(closed)
