"""For each kind of board: its parser, a sound answer, and what else a sound answer may look like."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hardware.relay import feedback, gd32, lcus, modbus, numato, sainsmart
from hardware.relay.errors import GarbledReplyError


class Answer(NamedTuple):
    """An answer from the wire, and the states that it reports."""

    parse: Callable[[bytes], object]
    sound: bytes
    states: object
    chance: float
    """Largest part of mutated answers that may pass for another sound one: a checksum's."""


def _lowest(data: bytes, channels: int = 4) -> tuple[bool, ...]:
    mask = numato.parse_answer(data, "relay readall", 2)
    return tuple(bool(mask >> i & 1) for i in range(channels))


ANSWERS = {
    "lcus": Answer(
        lambda d: lcus.parse_report(d, 4),
        b"CH1: ON \r\nCH2: OFF\r\nCH3: ON \r\nCH4: OFF\r\n",
        (True, False) * 2,
        0.0,
    ),
    "modbus": Answer(
        lambda d: modbus.parse_coils(d, 4), bytes.fromhex("01010105918B"), (True, False) * 2, 1e-4
    ),
    "feedback": Answer(lambda d: feedback.parse_state(d, 2), bytes.fromhex("A00201A3"), True, 1e-4),
    "gd32": Answer(lambda d: gd32.parse_line(d, 2), b"CH2:ON\r\n", True, 0.0),
    # Nothing protects these digits: a flipped one is another answer.
    "numato": Answer(_lowest, b"relay readall\n\r05\n\r>", (True, False) * 2, 1.0),
    "sainsmart": Answer(lambda d: sainsmart.parse_coils(d, 4), b":FE01020500FA\r\n", (True, False) * 2, 2e-3),
}


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


def believed_wrongly(answer: Answer, count: int, seed: int = 1) -> float:
    """The part of mutated and random answers that are taken for another state than the true one.

    Raises what a parser raises beside its own error.
    """
    rng = np.random.default_rng(seed)
    wrong = 0
    for i in range(count):
        data = mutated(answer.sound, rng) if i % 4 else rng.bytes(int(rng.integers(len(answer.sound) + 4)))
        try:
            wrong += answer.parse(data) != answer.states
        except GarbledReplyError:
            continue
    return wrong / count
