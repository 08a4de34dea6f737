"""All-off on every board, with each byte of its exchange damaged; the emulator's own contacts judge."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import pytest

from eldir_hardware.relay.a0 import PerChannelQueryBoard
from eldir_hardware.relay.errors import ContactError, GarbledReplyError, NotProvenOffError
from eldir_hardware.relay.registration import get_board, installed_kinds
from eldir_hardware.relay.sainsmart import parse_ascii_coils
from eldir_hardware.rig.devices import get_driver
from eldir_hardware.testing import Damage, close_contacts, wired

CHANNELS, RELAYS = 4, 8
ANSWER = {"feedback": 4, "gd32": 9, "lcus": 40, "modbus": 7, "mosfet": 25, "numato": 19, "sainsmart": 17}
"""Bytes of an answer; of `lcus` those of the relays beyond the rig file's; of other packages' boards: all."""
KINDS = [kind for kind in installed_kinds() if get_board(kind).max_channels >= RELAYS]
Struck = tuple[str, Damage | None, Damage | None]


def heated(kind: str, *, known: bool, deaf: int = 0, relays: int = RELAYS):
    """A board with all contacts closed; `known`: whether its driver has proven all-off before."""
    emulated, board, wire = wired(kind, CHANNELS, relays)
    if known:
        board.all_off()
    close_contacts(emulated, range(1, relays + 1))
    emulated.faults.deaf.update({deaf} - {0})
    assert all(emulated.contacts)
    wire.strike()
    return emulated, board, wire


def struck(kind: str, known: bool, relays: int = RELAYS, *, whole: bool) -> Iterator[Struck]:
    """Damages to every byte of an all-off: a name, the damage on the way there, and on the way back.

    `whole`: every bit of an answer, and both delays; otherwise two bits of each byte and a delay, in turn.
    """
    _, board, wire = heated(kind, known=known, relays=relays)
    board.all_off()
    there, back = wire.sent.count, wire.answered.count
    assert there and back
    for i in range(there):
        yield f"command byte {i} lost", Damage(dropped=i), None
        yield f"command byte {i} garbled", Damage(garbled=i), None
    for i in range(back):
        yield f"answer byte {i} lost", None, Damage(dropped=i)
        for bit in range(8) if whole else (i % 8, (i + 3) % 8):
            yield f"answer byte {i}, bit {bit} wrong", None, Damage(garbled=i, bit=bit)
        yield f"answers cut at byte {i}", None, Damage(cut=i)
        yield f"an answer lost from byte {i}", None, Damage(cut=i, lost=ANSWER.get(kind, back))
        for late in (0.35, 0.7) if whole else ((0.35, 0.7)[i % 2],):
            yield f"answers {late} s late from byte {i}", None, Damage(late_from=i, late=late)


STRESS = pytest.mark.stress


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=STRESS)], ids=["some bits", "every bit"])
@pytest.mark.parametrize(
    ("kind", "known"),
    [
        *((k, False) for k in KINDS),
        *(pytest.param(k, True, marks=[] if k in ("lcus", "mosfet") else STRESS) for k in KINDS),
    ],
)
def test_every_contact_opens_whichever_byte_is_damaged(kind, known, whole, capsys):
    """Those beyond the rig file's channels too. One damaged byte is made up for by another attempt."""
    longest, count = 0.0, 0
    for what, there, back in struck(kind, known, whole=whole):
        emulated, board, wire = heated(kind, known=known)
        before, begun = len(emulated.contact_events), board._clock.now()
        wire.strike(there, back)
        try:
            board.all_off()
        except NotProvenOffError:
            lasting = back is not None and ((back.cut >= 0 and back.lost > 99) or back.late)
            assert lasting, f"{what}: once only"
        assert not any(emulated.contacts), what
        opened = [e.t for e in emulated.contact_events[before:] if not e.closed]
        if there is None:  # nothing was lost on the way to the board
            assert max(opened) - begun < 0.2, what
        longest, count = max(longest, max(opened) - begun), count + 1
    with capsys.disabled():
        print(f" {count} damages, last contact open after {longest:.2f} s", end="")


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=STRESS)], ids=["some bits", "every bit"])
@pytest.mark.parametrize(
    ("kind", "deaf", "relays"),
    [
        *((k, 7, RELAYS) for k in KINDS),
        ("modbus", 2, RELAYS),
        ("modbus", 12, 16),
        *(pytest.param(k, 2, RELAYS, marks=STRESS) for k in KINDS if k != "modbus"),
        *(pytest.param(k, 12, 16, marks=STRESS) for k in ("mosfet", "numato")),
    ],
)
def test_no_damage_proves_off_what_is_on(kind, deaf, relays, whole):
    """Channels 7 and 12 are beyond the rig file's four."""
    for what, there, back in struck(kind, False, relays, whole=whole):
        emulated, board, wire = heated(kind, known=False, deaf=deaf, relays=relays)
        wire.strike(there, back)
        with suppress(NotProvenOffError):
            board.all_off()
            pytest.fail(f"{what}: proven off while contact {deaf} is closed")
        assert [c for c, closed in enumerate(emulated.contacts, 1) if closed] == [deaf], what


@pytest.mark.parametrize("kind", ["feedback", "modbus", "mosfet", "numato", "sainsmart"])
def test_a_damaged_echo_costs_no_attempt(kind):
    """Only the read-back counts: the first byte of the first command's answer is changed."""
    _, board, wire = heated(kind, known=True)
    board.all_off()
    commands = wire.sent.count
    _, board, wire = heated(kind, known=True)
    wire.strike(None, Damage(garbled=0))
    board.all_off()
    assert wire.sent.count == commands


def test_a_report_that_has_lost_a_digit_is_no_report():
    emulated, board, wire = heated("numato", known=True)
    board.all_off()
    board.switch({3: True})
    emulated.set_coil(3, False)
    assert emulated.obey(b"relay readall\r") == b"relay readall\n\r00\n\r>"
    wire.strike(None, Damage(dropped=len(b"relay readall\n\r0")))
    with pytest.raises(GarbledReplyError, match="has too few digits; expected 2 digits; found 0"):
        board.read_states(attempts=1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_silent_board_gets_its_commands(kind):
    emulated, board, _ = heated(kind, known=False)
    emulated.faults.silent = True
    begun = board._clock.now()
    with pytest.raises(NotProvenOffError):
        board.all_off()
    opened = [e.t for e in emulated.contact_events if not e.closed]
    assert not any(emulated.contacts) and max(opened) - begun < 0.2
    assert board._clock.now() - begun < 2.5, "it gives up soon"


@pytest.mark.parametrize("kind", KINDS)
def test_a_closed_contact_beyond_the_rig_file_is_named(kind):
    emulated, board, _ = heated(kind, known=False, deaf=7)
    with pytest.raises(NotProvenOffError, match="contact 7 is closed, but the rig file has 4 channels"):
        board.all_off()
    emulated.faults.deaf.clear()
    board.all_off()
    assert emulated.contacts == (False,) * RELAYS
    close_contacts(emulated, [7])
    if issubclass(get_driver(kind), PerChannelQueryBoard):  # while heating only the channels in use are asked
        assert board.verify() == (False,) * CHANNELS
    else:
        with pytest.raises(ContactError, match="contact 7 is closed, but the rig file has 4 channels"):
            board.verify()


@pytest.mark.parametrize(("kind", "relays"), [("feedback", 16), ("gd32", 14), ("modbus", 16), ("modbus", 32),
                                              ("mosfet", 16), ("numato", 16), ("sainsmart", 16)])  # fmt: skip
def test_the_largest_board_of_a_kind(kind, relays):
    emulated, board, _ = wired(kind, 2, relays)
    close_contacts(emulated, range(1, relays + 1))
    board.all_off()
    assert emulated.contacts == (False,) * relays
    emulated.faults.deaf.add(relays)
    emulated.coils[-1] = True
    with pytest.raises(
        NotProvenOffError, match=f"contact {relays} is closed, but the rig file has 2 channels"
    ):
        board.all_off()


@pytest.mark.parametrize("kind", KINDS)
def test_a_board_as_large_as_its_rig_file(kind):
    """Relays that do not exist answer nothing, or with an error; both prove nothing wrong."""
    emulated, board, _ = wired(kind, 4, 4)
    close_contacts(emulated, range(1, 5))
    begun = board._clock.now()
    board.all_off()
    assert emulated.contacts == (False,) * 4
    assert board._clock.now() - begun < 1.0
    assert board.switch({3: True}) == (False, False, True, False)


@pytest.mark.parametrize("digits", [1, 2, 4])
def test_numato_masks_of_any_width(digits):
    """How many digits modules of two and four channels use is not documented."""
    emulated, board, _ = wired("numato", 4, 4)
    emulated.digits = digits
    emulated.set_coil(3, True)
    board.all_off()
    assert emulated.contacts == (False,) * 4
    board.switch({1: True, 4: True})
    board.switch({1: False, 2: True, 3: True, 4: False})
    assert emulated.contacts == (False, True, True, False)


@pytest.mark.parametrize("relays", [4, 8, 16])
def test_modbus_boards_that_leave_wrong_questions_unanswered(relays):
    """Boards are known that answer questions for eight coils and no other; coils are asked in eights."""
    emulated, board, _ = wired("modbus", 4, relays)
    emulated.answers_exceptions = False
    for channel in range(1, relays + 1):
        emulated.set_coil(channel, True)
    board.all_off()
    assert emulated.contacts == (False,) * relays
    begun = board._clock.now()
    assert board.switch({4: True}) == (False, False, False, True)
    assert board._clock.now() - begun < 0.15, "it is asked only once how many coils there are"
    emulated.set_coil(relays, True)
    if relays > 4:
        with pytest.raises(ContactError, match=f"contact {relays} is closed"):
            board.verify()


@pytest.mark.parametrize("echoes", [False, True])
def test_sainsmart_answers_to_a_mask(echoes):
    """By the standard, or by an echo as public drivers expect."""
    emulated, board, _ = wired("sainsmart", 4, 16)
    emulated.echoes_writes = echoes
    board.all_off()
    board.switch({1: True, 2: False, 3: True, 4: True})
    assert emulated.contacts[:5] == (True, False, True, True, False)


@pytest.mark.parametrize(
    "answer",
    [b":FE0100200000FF\r\n", b":FE0100000010F1\r\n", b":FE01020000FE\r\n"],
    ids=["table", "echo", "sum"],
)
def test_a_sainsmart_status_that_is_not_the_standards_proves_nothing(answer):
    """Such as the one in the vendor's table, whose layout is unknown."""
    with pytest.raises(GarbledReplyError):
        parse_ascii_coils(answer, 16)
