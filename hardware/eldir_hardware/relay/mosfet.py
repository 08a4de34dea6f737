"""The MOSFET board of this project: pulses are timed by the board, and its firmware keeps limits of its own.

Its protocol, and its wiring: docs/reference/mosfet-board.md. This driver shares no code with the firmware.
"""

from __future__ import annotations

import math
import re
from binascii import crc_hqx
from collections.abc import Mapping
from contextlib import suppress
from typing import NamedTuple

from eldir.core.arguments import require_value
from eldir.errors import InputError
from eldir_hardware.relay.board import RelayBoard, RunRequirements
from eldir_hardware.relay.errors import ContactError, GarbledReplyError, SilentBoardError
from eldir_hardware.relay.registration import Board

_VERSION = "1"
_MASK_BITS = 16
_DONE = "K"
_ANSWER = re.compile(
    rb"!(([0-9A-F]{4}) ([KOTBVX]) ([0-9A-F]{4}) ([-PWSB]) ([0-9A-F]{4})(.*))\*([0-9A-F]{4})\n"
)
_ANSWER_LENGTH = 25  # without extra fields
_LIMITS = " 1 08 06200 050 00400 0000"  # extra fields in the answers to LIMITS and WHY, for their lengths
_WHY = " 100 00500 100 C"
_ENTRY_LENGTH = len("01=100/00500")
_MIN_TIME = 0.001  # as 0 would mean no end [s]
_MAX_TIME = 99.999  # five digits of milliseconds [s]
_TRIPS = {
    "P": "its power was interrupted",
    "W": "its program hung and was reset by the watchdog",
    "S": "it received no command for too long",
    "B": "a channel used up its heat budget",
}
_REASONS = _TRIPS | {"C": "it was commanded", "T": "its time had ended"}
_REFUSALS = {
    "O": "its sequence number is old",
    "T": "everything is off until a new run begins",
    "B": "a channel has used up its heat budget",
    "V": "invalid value or channel",
    "X": "the board was reset in the meantime",
}


class Answer(NamedTuple):
    """An answer of the board."""

    code: str
    closed: int
    """Mask of the channels that are on, channel 1 in the lowest bit."""
    trip_code: str
    token: int
    extra: str


def parse_answer(data: bytes, sequence: int, extra: int = 0) -> Answer:
    """Parse one whole line as the answer to the request with that number. Raises `GarbledReplyError`.

    `extra`: length of the extra fields, which a refusal does not have.
    """
    match = _ANSWER.fullmatch(data)
    if (
        match is None
        or crc_hqx(match[1], 0xFFFF) != int(match[8], 16)
        or int(match[2], 16) != sequence
        or len(match[7]) != (extra if match[3].decode() == _DONE else 0)
    ):
        raise GarbledReplyError(
            "the MOSFET board's answer cannot be read",
            expected=f"!{sequence:04X}, its state and a valid checksum",
            found=repr(data[:60]),
            remedy="check the board's kind in the rig file",
        )
    return Answer(
        match[3].decode(), int(match[4], 16), match[5].decode(), int(match[6], 16), match[7].decode()
    )


class ChannelState(NamedTuple):
    """State of one channel as the board reports it."""

    power: float
    """Part of the full power, 0 to 1."""
    left_s: float
    """Time until the board switches it off [s]; 0 if only the loss of the host does."""
    budget: float
    """Remaining part of its heat budget, 0 to 1."""
    off_reason: str
    """Why it was last switched off."""


class MosfetBoard(RelayBoard):
    """One frame switches any number of channels, each for a time and at a part of the full power."""

    baud = 115200  # of no importance on USB
    settling = 0.0
    contact_time = 0.0
    answer_length = _ANSWER_LENGTH
    times_pulses = True
    retriggerable = True
    patience = 0.4
    fails_closed = True

    _sequence = 0
    _session_open = False
    _tripped = "-"

    def all_off(self) -> None:
        super().all_off()
        self._session_open = False

    def check_limits(self, requirements: RunRequirements) -> None:
        """Compare the run with the limits in the firmware, which must be looser than those of the run."""
        version, channels, max_on, duty, heartbeat, mask = self._request("LIMITS", len(_LIMITS)).extra.split()
        steady = {i + 1 for i in range(_MASK_BITS) if int(mask, 16) >> i & 1}
        remedy = "change the rig file, or the board's limits: eldir rig firmware"
        if version != _VERSION:
            raise InputError(
                "the MOSFET board has another version of the protocol",
                code="board.other-limits",
                expected=_VERSION,
                found=version,
                remedy="install the firmware again: eldir rig firmware",
            )
        for name, fits, allowed in (
            (
                "longest pulse",
                1e3 * requirements.max_on_s + 100 <= int(max_on),
                f"{int(max_on) / 1e3 - 0.1:g} s",
            ),
            ("duty", 100 * requirements.duty <= int(duty) + 1e-6, f"{int(duty) / 100:g}"),
            ("number of channels", self.channels <= int(channels), str(int(channels))),
            ("heartbeat", 1e3 * self.patience <= int(heartbeat), f"{int(heartbeat) / 1e3:g} s"),
        ):
            if not fits:
                raise InputError(
                    f"the MOSFET board does not allow this run: {name}",
                    code="board.other-limits",
                    expected=f"{allowed}, the limit of the board",
                    remedy=remedy,
                )
        if different := requirements.heating & steady | requirements.steady - steady:
            raise InputError(
                "the MOSFET board and the rig file differ in the channels that heat springs",
                code="board.other-channels",
                expected=f"channels {sorted(steady)} without a heat budget, as in the board's limits",
                found=f"channels {sorted(different)} otherwise in the rig file",
                remedy=remedy,
            )
        self._open_session()

    def hold(self, powers: Mapping[int, float], seconds: float) -> None:
        """Keep channels closed for `seconds` [s], each at a part of the full power, 0 to 1 in steps of 0.01.

        The board modulates with a period of 0.1 s. Repeat the command in time to continue.
        """
        for channel, power in powers.items():
            require_value("relay channel", 1 <= channel <= self.channels, f"1 to {self.channels}", channel)
            require_value("power", 0 <= power <= 1, "0 to 1", power)
        seconds = max(seconds, _MIN_TIME)
        self._set({c: (round(100 * p), seconds) for c, p in powers.items()})
        self._commanded |= {c: round(100 * p) > 0 for c, p in powers.items()}

    def channel_state(self, channel: int) -> ChannelState:
        """Power, remaining time and heat budget of a channel, and why it last went off."""
        power, left, budget, why = self._request(f"WHY {channel:02d}", len(_WHY)).extra.split()
        return ChannelState(
            int(power) / 100, int(left) / 1e3, int(budget) / 100, _REASONS.get(why, "unknown")
        )

    def verify(self, attempts: int = 2) -> tuple[bool, ...]:
        try:
            return super().verify(attempts)
        except ContactError as error:
            if self._tripped == "-":
                raise
            raise ContactError(
                f"{error.args[0].split(';')[0]}: the board itself opened every contact because "
                f"{_TRIPS[self._tripped]}",
                remedy="find out why before you heat again",
            ) from None

    def _command(self, channel: int, closed: bool) -> None:
        self._command_timed({channel: closed}, {})

    def _command_timed(self, changes: Mapping[int, bool], pulses: Mapping[int, float]) -> None:
        steady = {c: (100 if closed else 0, 0.0) for c, closed in changes.items()}
        self._set(steady | {c: (100, max(seconds, _MIN_TIME)) for c, seconds in pulses.items()})

    def _command_all_off(self) -> None:
        # The answer is read, lest it be taken for that of the report; it may be lost or damaged.
        with suppress(SilentBoardError, GarbledReplyError):
            self._request("OFF")

    def _frames(self, changes: Mapping[int, bool]) -> list[tuple[int, int]]:
        entries = len(changes) * (_ENTRY_LENGTH + 1) - 1
        return [(len(":0000 SET ") + entries + len("*0000\n"), _ANSWER_LENGTH)]

    def _set(self, entries: Mapping[int, tuple[int, float]]) -> None:
        if not self._session_open:
            self._open_session()
        text = (
            f"{channel:02d}={power:03d}/{math.ceil(1e3 * min(seconds, _MAX_TIME) - 1e-6):05d}"
            for channel, (power, seconds) in entries.items()
        )
        self._request("SET " + ",".join(text))

    def _open_session(self) -> None:
        """Acknowledge why everything was off, with the present token of the board."""
        self._request(f"BEGIN {self._request('ASK').token:04X}")
        self._session_open = True

    def _report(self) -> tuple[bool, ...]:
        mask = self._request("ASK").closed
        return tuple(bool(mask >> i & 1) for i in range(_MASK_BITS))

    def _report_time(self) -> float:
        return self._line.wire_time(len(":0000 ASK*0000\n") + _ANSWER_LENGTH)

    def _request(self, text: str, extra: int = 0) -> Answer:
        """Send a request, whose answer has `extra` characters more. Raises `ContactError` for a refusal."""
        self._sequence = self._sequence % 0xFFFF + 1
        body = f"{self._sequence:04X} {text}".encode()
        request = b":" + body + b"*%04X\n" % crc_hqx(body, 0xFFFF)
        data = self._line.query_until(request, b"\n", _ANSWER_LENGTH + extra, self._is_late_answer)
        answer = parse_answer(data, self._sequence, extra)
        self._tripped = answer.trip_code
        if answer.code != _DONE:
            command = text.split(maxsplit=1)[0]
            reason = f", because {_TRIPS[answer.trip_code]}" if answer.trip_code in _TRIPS else ""
            raise ContactError(
                f"the MOSFET board refuses {command}: {_REFUSALS[answer.code]}{reason}",
                remedy="find out why before you heat again",
            )
        return answer

    def _is_late_answer(self, data: bytes) -> bool:
        """Whether this is an answer to another request, such as one that a previous program sent."""
        match = _ANSWER.fullmatch(data)
        return match is not None and int(match[2], 16) != self._sequence


BOARD = Board(MosfetBoard, "eldir_hardware.emulator.mosfet:EmulatedMosfet")
