"""The line protocol of the MOSFET board: requests in, answers out. Only `ChannelLimits`
switches channels.

A request is `:`, four digits of a sequence number, a space, words, `*`, four digits of a CRC-16 and a line's
end; an answer begins with `!` instead. All digits are hexadecimal capitals but those of quantities. What is
not a whole valid request gets no answer.

Runs on MicroPython and on CPython: no imports.
"""

VERSION = 1
MAX_REQUEST = 256
"""Bytes of the longest request; sixteen channels take 219."""

DONE = "K"
STALE = "O"
TRIPPED = "T"
EXHAUSTED = "B"
INVALID = "V"
WRONG_TOKEN = "X"

_HEX = "0123456789ABCDEF"
_NOTHING = "-"


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 1021, from FFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021) & 0xFFFF if crc & 0x8000 else crc << 1
    return crc


def with_crc(head: str, words: str) -> bytes:
    """A line of these words with its CRC and its end. `head` is `:` or `!`."""
    body = words.encode()
    return head.encode() + body + b"*%04X\n" % crc16(body)


def parse_number(text: str, digits: str) -> int:
    """A number in these digits, whose count is the base; -1 for another text."""
    value = 0
    for letter in text:
        digit = digits.find(letter)
        if digit < 0:
            return -1
        value = value * len(digits) + digit
    return value if text else -1


def _parse_request(line: bytes) -> str:
    """The words of a request without its CRC; empty if it is invalid. Noise or a truncated request before it
    is skipped."""
    start, end = line.rfind(b":"), len(line) - 6
    if start < 0 or end <= start or line[end : end + 1] != b"*" or line[-1:] != b"\n":
        return ""
    body = line[start + 1 : end]
    for byte in line[start:-1]:
        if byte < 32 or byte > 126:
            return ""
    if parse_number(line[end + 1 : -1].decode(), _HEX) != crc16(body):
        return ""
    return body.decode()


class RequestHandler:
    """Obeys the requests of a host. `limits`: a `ChannelLimits`. `token`: a number that differs at every
    reset."""

    def __init__(self, limits, token: int) -> None:  # type: ignore[no-untyped-def] # flat imports on the board
        self.mismatched_gates = 0
        """Gates that read back another level than was written, channel 1 in the lowest bit."""
        self._limits = limits
        self._token = token & 0xFFFF
        self._last_sequence = 0

    def answer(self, line: bytes, now: int) -> bytes:
        """Obey one line that came at `now` [ms ticks], and return the answer; empty for no answer."""
        self._limits.step(now)
        words = _parse_request(line).split(" ")
        sequence = parse_number(words[0], _HEX) if len(words[0]) == 4 else -1
        if sequence < 0 or len(words) < 2:
            return b""
        is_new = 0 < (sequence - self._last_sequence & 0xFFFF) < 0x8000
        if is_new:
            self._last_sequence = sequence
            self._limits.reset_heartbeat()
        verb, rest = words[1], words[2:]
        extra = ""
        if verb == "OFF" and not rest:  # also with an old sequence number: it only switches off
            self._limits.all_off()
            code = DONE
        elif verb == "ASK" and not rest:
            code = DONE
        elif verb == "SET" and len(rest) == 1:
            code = self._set(rest[0]) if is_new else STALE
        elif verb == "BEGIN" and len(rest) == 1:
            code = self._begin(rest[0], sequence)
        elif verb == "LIMITS" and not rest:
            code, extra = DONE, self._describe_limits()
        elif verb == "WHY" and len(rest) == 1 and self._channel(rest[0]) >= 0:
            code, extra = DONE, self._describe_channel(self._channel(rest[0]))
        else:
            code = INVALID
        return with_crc("!", f"{sequence:04X} {code} {self._state()}{extra}")

    def _state(self) -> str:
        limits = self._limits
        return f"{limits.on_mask() ^ self.mismatched_gates:04X} {limits.trip_reason} {self._token:04X}"

    def _describe_limits(self) -> str:
        limits = self._limits
        steady = 0
        for i in range(limits.channels):
            if limits.steady[i]:
                steady |= 1 << i
        texts = f"{limits.max_on_ms:05d} {limits.duty_percent:03d} {limits.heartbeat_ms:05d}"
        return f" {VERSION} {limits.channels:02d} {texts} {steady:04X}"

    def _describe_channel(self, channel: int) -> str:
        limits = self._limits
        budget = limits.budget_percent(channel)
        power, ms = limits.power[channel], limits.remaining_ms[channel]
        return f" {power:03d} {ms:05d} {budget:03d} {limits.off_reason[channel]}"

    def _begin(self, token: str, sequence: int) -> str:
        """Begin a session of a host that knows the token; a repeated old request does not."""
        if len(token) != 4 or parse_number(token, _HEX) != self._token:
            return WRONG_TOKEN
        self._token = (self._token * 25173 + 13849) & 0xFFFF
        self._last_sequence = sequence
        self._limits.acknowledge()
        return DONE

    def _set(self, text: str) -> str:
        """Switch the channels of `01=100/00500,...` (channel, power in per cent, ms), all of them or none."""
        limits, wanted = self._limits, []
        for entry in text.split(","):
            channel, power, ms = self._channel(entry[:2]), parse_number(entry[3:6], "0123456789"), -1
            if len(entry) == 12 and entry[2] == "=" and entry[6] == "/":
                ms = parse_number(entry[7:], "0123456789")
            if channel < 0 or ms < 0 or not 0 <= power <= 100:
                return INVALID
            wanted.append((channel, power, ms))
        for channel, power, _ in wanted:
            if power and limits.trip_reason != _NOTHING:
                return TRIPPED
            if power and not limits.is_allowed(channel, power):
                return EXHAUSTED
        for channel, power, ms in wanted:
            limits.switch(channel, power, ms)
        return DONE

    def _channel(self, text: str) -> int:
        """The channel of two digits, from 0; -1 for none."""
        channel = parse_number(text, "0123456789") if len(text) == 2 else -1
        return channel - 1 if 1 <= channel <= self._limits.channels else -1
