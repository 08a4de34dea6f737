"""A live connection for Foxglove: this process follows the log, as the page does, and passes its messages on.

It is told on its input which log to follow; it ends with its input. It takes nothing from who is connected.
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

_POLL = 0.03  # [s]
_OLD = 2.0  # what is older when it is first seen is the past, which Foxglove reads from the log [s]
_LATCHED = {kind.name for kind in m.KINDS.values() if kind.latched}


class _Channels(foxglove.ServerListener):
    """One channel for each topic, with the type and the bytes of the log."""

    def __init__(self) -> None:
        self._channels: dict[str, foxglove.Channel] = {}
        self._last: dict[str, tuple[bytes, int]] = {}

    def log(self, kind: str, followed: LogMessage) -> None:
        """Pass one message on; of an old one only a channel is made."""
        topic, stamp = followed.topic, followed.stamp_ns
        if topic not in self._channels:
            schema = foxglove.Schema(name=kind, encoding="ros2msg", data=m.Kind(kind).definition.encode())
            self._channels[topic] = foxglove.Channel(topic, schema=schema, message_encoding="cdr")
        data = bytes(followed.message)
        if kind in _LATCHED:
            self._last[topic] = data, stamp
        if time.time_ns() - stamp < _OLD * 1e9:
            self._channels[topic].log(data, log_time=stamp)

    def on_subscribe(
        self, client: foxglove.websocket.Client, channel: foxglove.websocket.ChannelView
    ) -> None:
        """Who comes late gets the last message of a topic that speaks seldom, such as the lens."""
        if channel.topic in self._last:
            data, stamp = self._last[channel.topic]
            self._channels[channel.topic].log(data, log_time=stamp)

    def close(self) -> None:
        """End all channels: the next log has its own."""
        for channel in self._channels.values():
            channel.close()
        self._channels, self._last = {}, {}


def main() -> None:
    """Serve at the port that is the first argument until the input ends."""
    os.nice(10)  # whatever else this computer does comes first
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
            with suppress(EldirError, OSError, ValueError):  # of a damaged log the rest is not shown
                for followed in log.poll():
                    channels.log(log.kind_of(followed.topic), followed)
    server.stop()


def _paths() -> Iterator[Path | None]:
    """Each log that is named on the input; None every `_POLL` while none is."""
    while True:
        ready, _, _ = select([sys.stdin], [], [], _POLL)
        if not ready:
            yield None
        elif line := sys.stdin.readline():
            yield Path(line.strip())
        else:
            return


if __name__ == "__main__":
    main()
