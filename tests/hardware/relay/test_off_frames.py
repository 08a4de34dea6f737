"""The frames that `eldir rig off` sends to a board whose kind it does not know: they close no contact."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldir_hardware.clock import VirtualClock
from eldir_hardware.relay.errors import RelayError
from eldir_hardware.relay.off_frames import RecordedLine, off_bursts, off_frames
from eldir_hardware.relay.registration import board_of, kinds
from eldir_hardware.rig.boards import emulator_of
from eldir_hardware.testing.powered_board import close_contacts

KINDS = tuple(kind for kind in kinds() if kind != "mosfet")
"""The MOSFET board obeys nothing but whole lines with a checksum: firmware/test_mosfet_firmware.py."""


def asked(kind: str, channels: int) -> bytes:
    """What a driver writes to prove that everything is off, with no answer."""
    line = RecordedLine(board_of(kind).driver.baud)
    driver = board_of(kind).driver(line, channels, VirtualClock())
    with suppress(RelayError):
        driver.all_off()
    for channel in range(1, channels + 1):
        driver._wanted[channel] = False
        with suppress(RelayError):
            driver.states()
    return line.written


BYTES = {kind: off_frames(kind) for kind in KINDS}
PROOFS = [asked(kind, n) for kind in KINDS for n in {1, 4, 8, board_of(kind).most_channels}]


class Deaf:
    """An emulated board without a pseudo-terminal."""

    def __init__(self, kind: str, channels: int, closed: set[int]):
        self.board = emulator_of(kind)(channels, VirtualClock())
        self.board._host = -1
        self.board.faults.silent = True
        close_contacts(self.board, closed)
        self.edges_before = len(self.board.edges)

    def hear(self, data: bytes) -> None:
        self.left = self.board._serve_requests(data)

    @property
    def closed_since(self) -> list:
        return [e for e in self.board.edges[self.edges_before :] if e.closed]


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_no_other_kinds_frames_close_a_contact(kind, data):
    """In any order, repeated, and cut anywhere, as where two programs write at once."""
    channels = data.draw(st.integers(1, board_of(kind).most_channels))
    closed = data.draw(st.sets(st.integers(1, channels)))
    board = Deaf(kind, channels, closed)
    parts = data.draw(st.lists(st.sampled_from([*BYTES.values(), *PROOFS]), min_size=1, max_size=8))
    cut = data.draw(st.integers(0, 40))
    board.hear(parts[0][cut:] + b"".join(parts))
    assert board.closed_since == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("known", [False, True])
def test_the_frames_open_every_contact_of_a_board_of_any_size(kind, known):
    for channels in range(1, board_of(kind).most_channels + 1):
        board = Deaf(kind, channels, set(range(1, channels + 1)))
        board.hear(off_frames(kind, channels if known else None))
        assert not any(board.board.contacts), channels


def test_all_kinds_in_a_row_open_the_board_that_is_there():
    for kind in KINDS:
        for channels in {1, 4, 8, board_of(kind).most_channels}:
            board = Deaf(kind, channels, set(range(1, channels + 1)))
            board.hear(b"".join(frames for frames, _ in off_bursts([(k, None) for k in KINDS])))
            assert not any(board.board.contacts), (kind, channels)
