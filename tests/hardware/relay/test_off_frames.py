"""The frames that `eldir rig off` sends to a board whose kind it does not know: they close no contact."""

from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir_hardware.clock import VirtualClock
from eldir_hardware.relay.errors import RelayError
from eldir_hardware.relay.registration import get_board, installed_kinds
from eldir_hardware.rig.devices import get_emulator
from eldir_hardware.safety.off_frames import RecordingLine, off_bursts, off_frames
from eldir_hardware.testing import close_contacts

KINDS = tuple(kind for kind in installed_kinds() if kind != "mosfet")
"""The MOSFET board obeys nothing but whole lines with a checksum: firmware/test_mosfet_firmware.py."""


def asked(kind: str, channels: int) -> bytes:
    """What a driver writes to prove that everything is off, with no answer."""
    line = RecordingLine(get_board(kind).driver.baud)
    driver = get_board(kind).driver(line, channels, VirtualClock())
    with suppress(RelayError):
        driver.all_off()
    for channel in range(1, channels + 1):
        driver._commanded[channel] = False
        with suppress(RelayError):
            driver.read_states()
    return b"".join(line.frames)


BYTES = {kind: off_frames(kind) for kind in KINDS}
PROOFS = [asked(kind, n) for kind in KINDS for n in {1, 4, 8, get_board(kind).max_channels}]


class Deaf:
    """An emulated board without a pseudo-terminal."""

    def __init__(self, kind: str, channels: int, closed: set[int]):
        self.board = get_emulator(kind)(channels, VirtualClock())
        self.board._board_end = -1
        self.board.faults.silent = True
        close_contacts(self.board, closed)
        self.edges_before = len(self.board.contact_events)

    def hear(self, data: bytes) -> None:
        self.left = self.board._serve_requests(data)

    @property
    def closed_since(self) -> list:
        return [e for e in self.board.contact_events[self.edges_before :] if e.closed]


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
@settings(max_examples=40)
def test_no_other_kinds_frames_close_a_contact(kind, data):
    """In any order, repeated, and cut anywhere, as where two programs write at once."""
    channels = data.draw(st.integers(1, get_board(kind).max_channels))
    closed = data.draw(st.sets(st.integers(1, channels)))
    board = Deaf(kind, channels, closed)
    parts = data.draw(st.lists(st.sampled_from([*BYTES.values(), *PROOFS]), min_size=1, max_size=8))
    cut = data.draw(st.integers(0, 40))
    board.hear(parts[0][cut:] + b"".join(parts))
    assert board.closed_since == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("known", [False, True])
def test_the_frames_open_every_contact_of_a_board_of_any_size(kind, known):
    for channels in range(1, get_board(kind).max_channels + 1):
        board = Deaf(kind, channels, set(range(1, channels + 1)))
        board.hear(off_frames(kind, channels if known else None))
        assert not any(board.board.contacts), channels


def test_all_kinds_in_a_row_open_the_board_that_is_there():
    for kind in KINDS:
        for channels in {1, 4, 8, get_board(kind).max_channels}:
            board = Deaf(kind, channels, set(range(1, channels + 1)))
            board.hear(b"".join(frames for frames, _ in off_bursts([(k, None) for k in KINDS])))
            assert not any(board.board.contacts), (kind, channels)
