"""A connection of the page's server: one that asks nothing is ended, so that Stop always finds a place."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_SILENT = 64
"""Beyond this number the oldest one that has asked nothing is ended. Pages that are open do not count."""
_PATIENCE = 10.0  # until a request must be complete up to its empty line [s]


class Connection(H11Protocol):
    """HTTP; without a request it ends after a while, or earlier where there are many such."""

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        loop = asyncio.get_running_loop()
        self._since = loop.time()
        loop.call_later(_PATIENCE, self._end_if_silent)
        silent = [c for c in self.connections if isinstance(c, Connection) and c._is_silent]
        if len(silent) > MOST_SILENT:
            min(silent, key=lambda c: c._since)._end_if_silent()

    @property
    def _is_silent(self) -> bool:
        """Whether no request has come. A page's socket has another protocol from its request on."""
        is_http = self.transport.get_protocol() is self
        return is_http and self.cycle is None and not self.transport.is_closing()

    def _end_if_silent(self) -> None:
        if self._is_silent:
            self.transport.abort()
