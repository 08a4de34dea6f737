"""Lines of the sensor's protocol: a letter, a sequence number, words, and a CRC."""

from __future__ import annotations

from binascii import crc_hqx

LONGEST = 512
"""Bytes of the longest line: sixteen inputs take 300."""


def question(letter: str, sequence: int) -> bytes:
    """A question to the microcontroller; `sequence` is 0 to 255."""
    text = f"{letter} {sequence:02X}".encode()
    return text + b"*%04X\n" % crc_hqx(text, 0xFFFF)


def words_of(line: bytes) -> list[str] | None:
    """The words of a line; None where it is damaged."""
    body, star, check = line.rstrip(b"\r\n").rpartition(b"*")
    if not star or check != b"%04X" % crc_hqx(body, 0xFFFF):
        return None
    try:
        return body.decode("ascii").split(" ")
    except UnicodeDecodeError:
        return None
