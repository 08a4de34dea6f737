"""Sound answers of boards from their manuals, and answers that noise has changed on the wire."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from eldir_hardware.clock import VirtualClock
from eldir_hardware.relay import feedback, gd32, lcus, modbus, mosfet, numato, sainsmart
from eldir_hardware.relay.errors import ContactError, GarbledReplyError, SilentBoardError
from eldir_hardware.relay.line import SerialLine
from eldir_hardware.rig.devices import get_driver, get_emulator


class Answer(NamedTuple):
    """An answer from the wire, and the states that it reports."""

    parse: Callable[[bytes], object]
    sound: bytes
    states: object


def _lowest(data: bytes, channels: int = 4) -> tuple[bool, ...]:
    mask = int(numato.parse_answer(data, "relay readall", 2), 16)
    return tuple(bool(mask >> i & 1) for i in range(channels))


def _closed(data: bytes, channels: int = 4) -> tuple[bool, ...]:
    mask = mosfet.parse_answer(data, 1).closed
    return tuple(bool(mask >> i & 1) for i in range(channels))


ANSWERS = {
    "lcus": Answer(
        lambda d: lcus.parse_report(d, 4),
        b"CH1: ON \r\nCH2: OFF\r\nCH3: ON \r\nCH4: OFF\r\n",
        (True, False) * 2,
    ),
    "modbus": Answer(
        lambda d: modbus.parse_rtu_coils(d, 4), bytes.fromhex("01010105918B"), (True, False) * 2
    ),
    "feedback": Answer(lambda d: feedback.parse_state(d, 2), bytes.fromhex("A00201A3"), True),
    "gd32": Answer(lambda d: gd32.parse_line(d, 2), b"CH2:ON\r\n", True),
    "numato": Answer(_lowest, b"relay readall\n\r05\n\r>", (True, False) * 2),
    "mosfet": Answer(_closed, b"!0001 K 0005 - 5EEE*2CA8\n", (True, False) * 2),
    "sainsmart": Answer(lambda d: sainsmart.parse_ascii_coils(d, 4), b":FE01020500FA\r\n", (True, False) * 2),
}
CHANCE = {"feedback": 1e-4, "gd32": 0.0, "lcus": 0.0, "modbus": 1e-4, "mosfet": 1e-5, "numato": 1.0}
"""Largest part of mutated answers that may pass for another sound one. Nothing protects Numato's digits."""
CHECKSUM = 2e-3
"""That part for any other board: one byte's checksum."""


def mutated(sound: bytes, rng: np.random.Generator) -> bytes:
    """One to three bytes changed, sometimes cut short, sometimes with noise behind."""
    data = bytearray(sound)
    for _ in range(int(rng.integers(1, 4))):
        data[int(rng.integers(len(data)))] = int(rng.integers(256))
    fate = rng.random()
    if fate < 0.3:
        data = data[: int(rng.integers(len(data) + 1))]
    elif fate < 0.4:
        data += rng.bytes(int(rng.integers(1, 9)))
    return bytes(data)


class NoisyLine(SerialLine):
    """Stands in for a driver's line: an emulated board answers, and noise changes one answer."""

    def __init__(self, kind: str, channels: int, seed: int):
        self.url, self.bytes_written = "nowhere", 0
        self.sent_at = 0.0
        self.emulated = get_emulator(kind)(channels, VirtualClock())
        self.emulated._wait_wire_time = lambda count: None  # type: ignore[method-assign]
        self.damage_at = -1
        self._rng = np.random.default_rng(seed)
        self._asked = 0

    def write(self, data: bytes) -> None:
        self._answer(data)

    def query(self, query: bytes, length: int) -> bytes:
        found = self._damaged(self._answer(query))[:length]
        if len(found) < length:
            raise (GarbledReplyError if found else SilentBoardError)("too few bytes")
        return found

    def query_until(self, query: bytes, end: bytes, most: int, late: object = None) -> bytes:
        found = self._damaged(self._answer(query))
        found = found[: found.find(end) + len(end)] if end in found else found
        if not found:
            raise SilentBoardError("no byte")
        return found[:most]

    def query_until_idle(self, query: bytes, least: int, most: int) -> bytes:
        found = self._damaged(self._answer(query))[: most + 40]
        if len(found) < least:
            raise (GarbledReplyError if found else SilentBoardError)("too few bytes")
        return found

    def query_each(self, queries: list[bytes], most: int) -> bytes:
        return b"".join(self._damaged(self._answer(query)) for query in queries)

    def wire_time(self, count: int) -> float:
        return 0.0

    def unblock(self) -> None:
        pass

    def _answer(self, query: bytes) -> bytes:
        answers: list[bytes] = []
        self.emulated.send_answer = answers.append  # type: ignore[method-assign]
        self.emulated._serve_requests(query)
        return b"".join(answers)

    def _damaged(self, answer: bytes) -> bytes:
        self._asked += 1
        if self._asked - 1 != self.damage_at:
            return answer
        if self._rng.random() < 0.25:
            return self._rng.bytes(int(self._rng.integers(len(answer) + 4)))
        return mutated(answer, self._rng)

    def begin(self, damage_at: int) -> int:
        """Count questions from 0 and damage the answer to that one; how many there were since last time."""
        asked, self._asked, self.damage_at = self._asked, 0, damage_at
        return asked


def believed_wrongly(kind: str, count: int, seed: int = 1) -> float:
    """The part of reports, each with one damaged answer, that a driver takes for another state.

    Raises what a driver raises beside its own errors.
    """
    line = NoisyLine(kind, 4, seed)
    driver = get_driver(kind)(line, 4, VirtualClock())
    wanted = (True, False, True, False)
    for channel, closed in enumerate(wanted, start=1):
        driver._command(channel, closed)
    line.begin(-1)
    assert driver.read_states() == wanted
    line.begin(-1)
    assert driver.read_states() == wanted, "it knows how many relays there are now"
    questions = line.begin(-1)
    wrong = 0
    for i in range(count):
        line.begin(i % questions)
        try:
            wrong += driver.read_states(attempts=1) != wanted
        except (GarbledReplyError, SilentBoardError, ContactError):  # the last: of a relay beyond these
            continue
    return wrong / count
