"""What drivers make of answers that are nearly right."""

import pytest

from eldir_hardware.relay import feedback, gd32, lcus, modbus, numato, sainsmart
from eldir_hardware.relay.errors import ContactError, GarbledReplyError
from eldir_hardware.testing import powered

RTU = modbus.rtu_checksum


@pytest.mark.parametrize(
    "answer",
    [
        "0101010591",  # too short
        "01010105918B00",  # too long
        "020101059C8B",  # another unit
        "0102010591CF",  # another function
        "010102059144",  # another count
        "01010105918C",  # another checksum
        "01010104918B",
    ],
)
def test_modbus_coils_are_refused(answer):
    data = bytes.fromhex(answer)
    with pytest.raises(GarbledReplyError, match=r"expected 6 bytes from 01 01 01 to a valid checksum"):
        modbus.parse_rtu_coils(data, 4)
    if len(data) == 6 and data[:3] != b"\x01\x01\x01":  # with a sound checksum too
        with pytest.raises(GarbledReplyError):
            modbus.parse_rtu_coils(data[:-2] + RTU(data[:-2]), 4)


def test_the_answer_of_another_unit_is_shown_with_the_unit_that_is_asked():
    body = b"\x02\x01\x01\x00"
    with pytest.raises(GarbledReplyError, match=r"found 02 01 01 00 .*set to unit 1 and 9600 baud"):
        modbus.parse_rtu_coils(body + RTU(body), 8)


@pytest.mark.parametrize(("channels", "count"), [(1, 1), (8, 1), (9, 2), (16, 2)])
def test_modbus_coils_of_any_number(channels, count):
    for closed in range(channels):
        body = bytes((1, 1, count)) + (1 << closed).to_bytes(count, "little")
        states = modbus.parse_rtu_coils(body + RTU(body), channels)
        assert states == tuple(i == closed for i in range(channels))


def sealed(*numbers: int) -> bytes:
    return sainsmart.ascii_request(*numbers)


@pytest.mark.parametrize(
    "answer",
    [
        b";FE01020500FA\r\n",
        b":FE01020500FA\n\r",
        b":FE01020500FA\r\n\n",
        b":FE01020500FB\r\n",
        b":FD01020500FB\r\n",  # another unit
        b":fe01020500fa\r\n",
        b":FE010205-0FA\r\n",
        b":FE010205FF\r\n",
        sealed(2, 2, 5, 0),  # another function
        sealed(1, 3, 5, 0),  # another count
        sealed(1, 2, 5, 0, 0),
    ],
)
def test_sainsmart_coils_are_refused(answer):
    with pytest.raises(GarbledReplyError, match="FE 01 02"):
        sainsmart.parse_ascii_coils(answer, 4)


def test_sainsmart_coils_of_both_bytes():
    for closed in range(16):
        answer = sealed(1, 2, *(1 << closed).to_bytes(2, "little"))
        assert sainsmart.parse_ascii_coils(answer, 16) == tuple(i == closed for i in range(16))


@pytest.mark.parametrize("kind", ["modbus", "sainsmart"])
@pytest.mark.parametrize("coil", [0, 1, 255])
def test_an_echo_of_another_command_is_no_confirmation(kind, coil):
    """Such as of another coil, or of another state of the same coil."""
    with powered(kind) as p:
        obey = p.emulated.obey
        other = modbus.rtu_request(5, coil, 0) if kind == "modbus" else sealed(5, 0, coil, 0, 0)
        p.emulated.obey = lambda request: (obey(request), other)[1]
        with pytest.raises(GarbledReplyError, match="did not confirm a command"):
            p.board.send({2: True})


@pytest.mark.parametrize("answer", ["A00201A3", "A0010", "A00100A2", "A00102A3"])
def test_feedback_confirms_with_a_state_of_the_same_channel(answer):
    with powered("feedback") as p:
        other = bytes.fromhex(answer.ljust(8, "0"))
        p.emulated.obey = lambda request: other
        with pytest.raises(GarbledReplyError, match="a0 01 00 a1 or a0 01 01 a2"):
            p.board.send({1: True})


@pytest.mark.parametrize("answer", ["", "CH1:ON\r", "CH1:ON \r\n", "CH2:OFF\r\n", "ch1:ON\r\n", "CH1:OFF\n"])
def test_gd32_lines_are_refused(answer):
    with pytest.raises(GarbledReplyError, match="CH1:ON or CH1:OFF"):
        gd32.parse_line(answer.encode(), 1)


@pytest.mark.parametrize(
    ("answer", "command", "least", "value"),
    [
        (b"relay readall\n\r0f\n\r>", "relay readall", 2, "0f"),
        (b"relay readall\r\n\r0F\n\r>", "relay readall", 2, "0F"),
        (b"relay readall\n\r80f1\n\r>", "relay readall", 4, "80f1"),
        (b"relay on 0\n\r>", "relay on 0", 0, ""),
        (b"relay on 0\n\r00\n\r>", "relay on 0", 0, None),
        (b"relay on 1\n\r>", "relay on 0", 0, None),
        (b"relay readall\n\r0f\n\r", "relay readall", 2, None),
        (b"relay readall\n\r0g\n\r>", "relay readall", 2, None),
        (b"relay readall\n\r0f\n\r>", "relay readall", 4, None),
        (b"relay readall\n\r000f\n\r>", "relay readall", 2, "000f"),  # the module's own width
        (b"relay readall\n\r" + 17 * b"0" + b"\n\r>", "relay readall", 2, None),
        (b"relay readall\n\r\n\r>", "relay readall", 2, None),
    ],
)
def test_numato_answers(answer, command, least, value):
    if value is None:
        told = f"echoed, {least} or more digits and a prompt" if least else "expected its echo"
        with pytest.raises(GarbledReplyError, match=told):
            numato.parse_answer(answer, command, least)
    else:
        assert numato.parse_answer(answer, command, least) == value


@pytest.mark.parametrize(("relays", "closed", "refused"), [(8, 5, True), (8, 8, True), (8, 4, False)])
def test_numato_reports_more_relays_than_the_rig_file_says(relays, closed, refused):
    with powered("numato", 4, relays) as p:
        p.emulated.set_coil(closed, True)
        if refused:
            with pytest.raises(ContactError, match=f"contact {closed} is closed, but the rig file has 4"):
                p.board.read_states()
        else:
            assert p.board.read_states() == (False, False, False, True)


@pytest.mark.parametrize("channels", [1, 2, 8])
def test_lcus_reports(channels):
    for closed in range(channels):
        states = tuple(i == closed for i in range(channels))
        lines = [f"CH{i}: {'ON ' if s else 'OFF'}\r\n" for i, s in enumerate(states, start=1)]
        assert lcus.parse_report("".join(lines).encode(), channels) == states
        for damaged in (lines[1:], [*lines, lines[0]], [*lines[:-1], lines[-1][:-1]]):
            with pytest.raises(GarbledReplyError, match=f"expected {channels} or more lines"):
                lcus.parse_report("".join(damaged).encode(), channels)
        for fewer in range(1, channels):  # the report tells how many relays there are
            assert lcus.parse_report("".join(lines).encode(), fewer) == states


def test_feedback_states():
    for channel, closed in ((1, True), (4, False), (16, True)):
        answer = bytes((0xA0, channel, closed, (0xA0 + channel + closed) & 0xFF))
        assert feedback.parse_state(answer, channel) is closed
