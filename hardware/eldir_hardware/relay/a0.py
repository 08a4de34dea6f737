"""The frame that all boards of the "A0" protocol share; their dialects give its bytes different meanings."""

from __future__ import annotations

_HEAD = 0xA0
FRAME_LENGTH = 4


def a0_frame(channel: int, value: int) -> bytes:
    """A0, channel, an operation or a state, and their checksum."""
    body = (_HEAD, channel, value)
    return bytes((*body, sum(body) & 0xFF))
