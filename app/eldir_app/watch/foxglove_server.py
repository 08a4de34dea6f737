"""A process that serves Foxglove: it follows the log, as the page does, and forwards its messages.

It reads from its input which log to follow, and ends with its input. It accepts no messages from clients.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from select import select

import foxglove

from eldir.errors import EldirError
from eldir_hardware.log import messages as m
from eldir_hardware.log.following import LogFollower, LogMessage

_POLL_INTERVAL_S = 0.03
_MAX_AGE_S = 2.0  # older messages are not forwarded: Foxglove can read them from the log
_LATCHED_TYPES = {kind.name for kind in m.MESSAGE_TYPES.values() if kind.latched}


class _Channels(foxglove.ServerListener):
    """One channel for each topic, with the type and the bytes of the log."""

    def __init__(self) -> None:
        self._channels: dict[str, foxglove.Channel] = {}
        self._last: dict[str, tuple[bytes, int]] = {}

    def log(self, kind: str, logged: LogMessage) -> None:
        """Forward one message; for an old one, only make the channel."""
        topic, stamp = logged.topic, logged.stamp_ns
        if topic not in self._channels:
            schema = foxglove.Schema(
                name=kind, encoding="ros2msg", data=m.MessageType(kind).definition.encode()
            )
            self._channels[topic] = foxglove.Channel(topic, schema=schema, message_encoding="cdr")
        data = bytes(logged.message)
        if kind in _LATCHED_TYPES:
            self._last[topic] = data, stamp
        if time.time_ns() - stamp < _MAX_AGE_S * 1e9:
            self._channels[topic].log(data, log_time=stamp)

    def on_subscribe(
        self, client: foxglove.websocket.Client, channel: foxglove.websocket.ChannelView
    ) -> None:
        """Send the last message of a latched topic, such as the lens, to a new subscriber."""
        if channel.topic in self._last:
            data, stamp = self._last[channel.topic]
            self._channels[channel.topic].log(data, log_time=stamp)

    def close(self) -> None:
        """Close all channels: the next log has its own."""
        for channel in self._channels.values():
            channel.close()
        self._channels, self._last = {}, {}


def main() -> None:
    """Serve at the port in the first argument until the input ends."""
    os.nice(10)  # the driving program comes first
    foxglove.set_log_level("ERROR")
    channels = _Channels()
    server = foxglove.start_server(
        name="eldir", host="127.0.0.1", port=int(sys.argv[1]), server_listener=channels
    )
    print(server.port, flush=True)
    log: LogFollower | None = None
    for path in _paths():
        if path is not None:
            channels.close()
            log = LogFollower(path, raw=True)
            with suppress(EldirError, OSError):
                log.open()
        if log is not None:
            with suppress(EldirError, OSError, ValueError):  # the rest of a damaged log is not shown
                for logged in log.poll():
                    channels.log(log.get_type(logged.topic), logged)
    server.stop()


def _paths() -> Iterator[Path | None]:
    """The logs that are named on the input; None every `_POLL_INTERVAL_S` otherwise."""
    while True:
        ready, _, _ = select([sys.stdin], [], [], _POLL_INTERVAL_S)
        if not ready:
            yield None
        elif line := sys.stdin.readline():
            yield Path(line.strip())
        else:
            return


if __name__ == "__main__":
    main()
