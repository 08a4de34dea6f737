"""A host of the MOSFET board, good or bad: it talks with the firmware's own code, without a line between.

The judge knows what was sent and what the gates did, and nothing of how the firmware decides.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass, field

from hypothesis import strategies as st

from eldir_hardware.firmware.channel_limits import POWER_UP, ChannelLimits
from eldir_hardware.firmware.protocol import RequestHandler

WRAP = 1 << 30
CHANNELS, LONGEST_MS, DUTY, HEARTBEAT_MS, STEADY = 3, 2000, 40, 400, (3,)
MOST_STEP_MS = 40


def frame(sequence: int, words: str) -> bytes:
    """A request; its checksum is that of the standard library."""
    body = f"{sequence:04X} {words}".encode()
    return b":" + body + b"*%04X\n" % binascii.crc_hqx(body, 0xFFFF)


def setting(entries: list[tuple[int, int, int]]) -> str:
    return "SET " + ",".join(f"{c:02d}={power:03d}/{ms:05d}" for c, power, ms in entries)


@dataclass
class Moment:
    """What the gates did for a while."""

    begin_ms: int
    end_ms: int
    power: tuple[int, ...]


@dataclass
class Board:
    """The firmware with its clock, which begins again at 0 after 2**30 ms."""

    first_tick: int = WRAP - 3000
    now_ms: int = 0
    """Time since the start, which never begins again [ms]."""
    moments: list[Moment] = field(default_factory=list)
    lines: list[tuple[int, bytes]] = field(default_factory=list)
    """Ticks and lines as they came; an empty one where only time passed, b"!" at a reset."""
    answers: list[bytes] = field(default_factory=list)
    token: int = 0x1111

    def __post_init__(self) -> None:
        self.reset()

    @property
    def tick(self) -> int:
        return (self.first_tick + self.now_ms) % WRAP

    def reset(self) -> None:
        self.token += 1
        self.lines.append((self.tick, b"!"))
        self.limits = ChannelLimits(CHANNELS, LONGEST_MS, DUTY, HEARTBEAT_MS, STEADY, self.tick, POWER_UP)
        self.conversation = RequestHandler(self.limits, self.token)

    def wait(self, ms: int, step_ms: int = MOST_STEP_MS) -> None:
        while ms > 0:
            step = min(step_ms, ms)
            power = tuple(self.limits.power)
            self.now_ms += step
            ms -= step
            self.limits.step(self.tick)
            self.lines.append((self.tick, b""))
            self.moments.append(Moment(self.now_ms - step, self.now_ms, power))

    def say(self, line: bytes) -> bytes:
        self.lines.append((self.tick, line))
        answer = self.conversation.answer(line, self.tick)
        self.answers.append(answer)
        return answer

    def begin(self, sequence: int) -> bytes:
        """As a good host does: ask for the token, then begin with it."""
        token = self.say(frame(sequence, "ASK")).split(b"*")[0].split()[4].decode()
        return self.say(frame(sequence, f"BEGIN {token}"))


ENTRY = st.tuples(
    st.integers(0, 4),
    st.sampled_from((0, 1, 30, 40, 41, 70, 100, 101)),
    st.sampled_from((0, 1, 50, 500, 9999)),
)
ACTION = st.one_of(
    st.tuples(
        st.just("wait"), st.sampled_from((1, 30, 100, 300, 399, 401, 1500)), st.integers(1, MOST_STEP_MS)
    ),
    st.tuples(st.just("beats"), st.integers(1, 20), st.integers(20, 390)),
    st.tuples(st.just("set"), st.lists(ENTRY, min_size=1, max_size=3), st.integers(-2, 3)),
    st.tuples(st.just("heat"), st.integers(1, 3), st.sampled_from((30, 100))),
    st.tuples(
        st.just("say"),
        st.sampled_from(("ASK", "OFF", "LIMITS", "WHY 01", "BEGIN 1234", "OFF 1", "SET")),
        st.integers(-2, 3),
    ),
    st.tuples(st.just("begin")),
    st.tuples(st.just("noise"), st.binary(max_size=40), st.booleans()),
    st.tuples(st.just("replay"), st.integers(0, 30)),
    st.tuples(st.just("damage"), st.integers(0, 30), st.integers(0, 255)),
    st.tuples(st.just("reset")),
)
ACTIONS = st.lists(ACTION, max_size=40)
FIRST_TICK = st.sampled_from((0, WRAP - 1, WRAP - 700, WRAP - 5000, 12345))


def play(board: Board, actions: list[tuple]) -> None:  # noqa: PLR0912 # one case for each kind
    """Do what a host may do; sequence numbers go on by what the action says."""
    sequence = 0
    board.begin(sequence)
    for action in actions:
        sent = [line for _, line in board.lines if line not in (b"", b"!")]
        match action:
            case ("wait", ms, step):
                board.wait(ms, step)
            case ("beats", count, ms):
                for _ in range(count):
                    sequence += 1
                    board.say(frame(sequence & 0xFFFF, "ASK"))
                    board.wait(ms)
            case ("set", entries, more):
                sequence += more
                board.say(frame(sequence & 0xFFFF, setting(entries)))
            case ("heat", channel, power):
                sequence += 1
                board.say(frame(sequence & 0xFFFF, setting([(channel, power, 0)])))
            case ("say", words, more):
                sequence += more
                board.say(frame(sequence & 0xFFFF, words))
            case ("begin",):
                sequence += 1
                board.begin(sequence & 0xFFFF)
            case ("noise", data, ends):
                board.say(data.replace(b"\n", b"") + (b"\n" if ends else b""))
            case ("replay", back) if sent:
                board.say(sent[-1 - back % len(sent)])
            case ("damage", back, value) if sent:
                line = bytearray(sent[-1 - back % len(sent)])
                if line:
                    line[value % len(line)] ^= 1 << value % 8
                    board.say(bytes(line))
            case ("reset",):
                board.reset()
