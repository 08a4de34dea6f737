"""Which connections the page's server serves, and in which order, so that a stop is always served.

A connection waits, at little cost, until the head of its one request is complete. An allowed stop is served
at once; other requests follow one by one. No answer waits for a body, and each answer closes its connection.
Connections other than open pages and running stops are closed after `_MAX_AGE_S`, or earlier if there are too
many.
"""

from __future__ import annotations

import asyncio
import re
import resource
from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

_MAX_CONNECTIONS = 512  # fewer if this process may open fewer files
_EVICTED = 32  # closed together when there are too many
_MAX_AGE_S = 10.0  # from the start of a connection until its answer has been sent
_SWEEP_INTERVAL_S = 1.0  # between two searches for connections that are too old
_MAX_HEAD = 16_384  # of a request [bytes]; h11 refuses other parts that are too long
_END_OF_HEAD = re.compile(rb"\n\r?\n")


class AdmissionControl:
    """The connections of one server."""

    def __init__(self, is_stop: Callable[[bytes], bool]) -> None:
        """`is_stop`: whether the head of a request is that of an allowed stop."""
        self.is_stop = is_stop
        files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        self._max_connections = min(_MAX_CONNECTIONS, files // 2) if files > 0 else _MAX_CONNECTIONS
        self._connections: list[AdmittedConnection] = []
        self._queue: deque[AdmittedConnection] = deque()

    def __call__(self, **server: Any) -> AdmittedConnection:
        """The protocol of a new connection; `server`: the arguments that uvicorn gives its own protocols."""
        return AdmittedConnection(self, server)

    def add(self, connection: AdmittedConnection) -> None:
        """Add a new connection. If there are too many, close the oldest ones of the address that has most."""
        if not self._connections:
            asyncio.get_running_loop().call_later(_SWEEP_INTERVAL_S, self._sweep)
        self._connections.append(connection)
        if len(self._connections) > self._max_connections:
            self._connections = [c for c in self._connections if not c.is_closed]
            if len(self._connections) > self._max_connections:
                crowds = Counter(c.address for c in self._connections)
                self._connections.sort(key=lambda c: (c.is_needed, -crowds[c.address], c.since))
                for each in self._connections[:_EVICTED]:
                    each.end()

    def serve(self, connection: AdmittedConnection) -> None:
        """Serve a complete request: a stop now; others in turn, with new connections accepted in between."""
        if connection.is_stop:
            connection.serve()
            return
        self._queue.append(connection)
        if len(self._queue) == 1:
            asyncio.get_running_loop().call_soon(self._serve_next)

    def _serve_next(self) -> None:
        self._queue[0].serve()
        self._queue.popleft()
        if self._queue:
            asyncio.get_running_loop().call_soon(self._serve_next)

    def _sweep(self) -> None:
        loop = asyncio.get_running_loop()
        self._connections = [c for c in self._connections if not c.is_closed]
        for each in self._connections:
            if loop.time() - each.since > _MAX_AGE_S and not each.is_needed:
                each.end()
        if self._connections:
            loop.call_later(_SWEEP_INTERVAL_S, self._sweep)


class AdmittedConnection(asyncio.Protocol):
    """One connection: a protocol that waits for the head of the request, then HTTP takes over."""

    def __init__(self, control: AdmissionControl, server: dict[str, Any]):
        self._control = control
        self._protocol = partial(H11Protocol, **server)
        self._uvicorn_connections = server["server_state"].connections
        self._head = b""
        self._is_ended = False
        self.is_stop = False

    def connection_made(self, transport: Any) -> None:
        self._transport = transport
        peer = transport.get_extra_info("peername")
        self.address: str = peer[0] if peer else ""
        self.since = asyncio.get_running_loop().time()
        self._uvicorn_connections.add(self)
        self._control.add(self)

    def data_received(self, data: bytes) -> None:
        self._head += data
        if _END_OF_HEAD.search(self._head) or len(self._head) > _MAX_HEAD:
            self._transport.pause_reading()
            self.is_stop = self._control.is_stop(self._head)
            self._control.serve(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._uvicorn_connections.discard(self)

    def shutdown(self) -> None:
        """Close because the server ends."""
        self.end()

    def serve(self) -> None:
        """Hand the connection over to HTTP, together with the bytes received so far."""
        if not self._is_ended and not self._transport.is_closing():
            self._uvicorn_connections.discard(self)
            protocol = self._protocol()
            protocol.connection_made(self._transport)
            self._transport.set_protocol(protocol)
            self._transport.resume_reading()
            protocol.data_received(self._head)

    def end(self) -> None:
        """Close at once, even if the answer was not read."""
        self._is_ended = True
        self._transport.abort()

    @property
    def is_closed(self) -> bool:
        """Whether the connection is closed."""
        return self._is_ended or self._transport.get_extra_info("socket").fileno() < 0

    @property
    def is_needed(self) -> bool:
        """Whether a person waits for it: an open page, or a running stop."""
        protocol = self._transport.get_protocol()
        if isinstance(protocol, WebSocketsSansIOProtocol):
            return protocol.handshake_complete and not protocol.close_sent
        return self.is_stop and not self._transport.is_closing()
