"""Messages between the guardian and its parent: JSON, one packet each, on a pair of local sockets."""

from __future__ import annotations

import json
import socket
from contextlib import suppress
from typing import Any

LARGEST = 1 << 16
"""Largest message [bytes]; the rig of sixteen channels takes a twentieth."""


class Wire:
    """One end of the connection. It never blocks: a message that the other end does not take is dropped."""

    def __init__(self, end: socket.socket):
        self._end = end
        end.setblocking(False)

    @staticmethod
    def fits(**message: Any) -> bool:
        """Whether a message can be sent."""
        return len(json.dumps(message).encode()) < LARGEST

    def fileno(self) -> int:
        """File descriptor, for `select`."""
        return self._end.fileno()

    def send(self, **message: Any) -> bool:
        """Send a message to the other end, and return whether it is there and took it."""
        with suppress(OSError):
            self._end.send(json.dumps(message).encode())
            return True
        return False

    def receive(self) -> list[dict[str, Any]] | None:
        """Messages received since the last call; None when the other end has closed or died."""
        messages: list[dict[str, Any]] = []
        reset = False
        while True:
            try:
                packet = self._end.recv(LARGEST)
            except BlockingIOError:
                return messages
            except ConnectionResetError:  # raised once, before the last messages of the other end
                if not reset:
                    reset = True
                    continue
                packet = b""
            except OSError:
                packet = b""
            if not packet:
                return messages or None
            messages.append(json.loads(packet))

    def close(self) -> None:
        """Close this end; the other end notices."""
        self._end.close()
