"""Every frame to and from a device is logged at DEBUG, whatever its driver: the device's own record is the
same bytes."""

import fcntl
import logging
import re
import struct
import termios
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from eldir_hardware.clock import WallClock
from eldir_hardware.current_sensor import CurrentSensor
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.emulator.current_sensor import EmulatedCurrentSensor
from eldir_hardware.relay.board import RunRequirements
from eldir_hardware.relay.errors import SilentBoardError
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.rig.devices import get_driver, get_emulator
from eldir_hardware.safety.off_frames import UnlockedPort
from tests.hardware.emulated_rigs import wait

LINE, SENSOR, UNLOCKED = (
    "eldir_hardware.relay.line",
    "eldir_hardware.current_sensor",
    "eldir_hardware.safety.off_frames",
)


def recording(emulator: type[EmulatedBoard]) -> type[EmulatedBoard]:
    """The same device, which keeps the bytes that its own side of the line receives and sends."""

    class Recording(emulator):
        def __init__(self, *values, **options):
            self.received, self.sent = b"", b""
            super().__init__(*values, **options)

        def _serve_requests(self, data: bytes) -> bytes:
            before = getattr(self, "_unserved", b"")
            self._unserved = super()._serve_requests(data)
            self.received += data[len(before) :]  # last: whoever sees them here sees their answers in `sent`
            return self._unserved

        def deliver(self, answer: bytes) -> None:
            super().deliver(answer)
            self.sent += answer

    return Recording


@contextmanager
def served(device: EmulatedBoard) -> Iterator[EmulatedBoard]:
    device.start()
    try:
        yield device
    finally:
        device.close()


@pytest.fixture
def log(caplog):
    for name in (LINE, SENSOR, UNLOCKED):
        caplog.set_level(logging.DEBUG, name)
    return caplog


def logged(log, way: str, port: str) -> bytes:
    """The bytes in all lines of one direction and one port."""
    found = [
        re.fullmatch(rf"(?:{way}) {port}: ([0-9a-f ]+?)(?:  '.*')?", r.getMessage()) for r in log.records
    ]
    return b"".join(bytes.fromhex(match[1]) for match in found if match)


def waiting_bytes(board: EmulatedBoard) -> int:
    """What a driver could read at once. The kernel passes bytes of a pseudo-terminal on some time after they
    were written: until then they count as not arrived, and whoever drops the input drops them unseen."""
    return struct.unpack("i", fcntl.ioctl(board.client_end, termios.FIONREAD, bytes(4)))[0]


@pytest.mark.parametrize("kind", installed_kinds())
def test_the_log_has_the_bytes_of_the_board(kind, log):
    channels = 4
    with served(recording(get_emulator(kind))(channels, WallClock())) as board:
        driver = get_driver(kind)(board.port, channels, WallClock())
        driver.check_limits(RunRequirements(5.0, 0.5, frozenset(range(1, channels + 1)), frozenset()))
        driver.all_off()
        driver.switch({1: True, 3: True})
        driver.switch({1: False})
        driver.all_off()
        assert not any(board.contacts) and any(edge.closed for edge in board.contact_events)
        assert wait(lambda: len(board.received) == driver.bytes_written)
        read = logged(log, "from|dropped from", board.port)
        assert wait(lambda: len(read) + waiting_bytes(board) == len(board.sent))
        driver.close()  # an answer that nobody has read yet is logged too
        assert logged(log, "to", board.port) == board.received != b""
        assert wait(lambda: logged(log, "from|dropped from", board.port) == board.sent != b"")


def test_answers_that_come_too_late_are_logged(log):
    """With the word that the driver did not take them."""
    with served(recording(get_emulator("modbus"))(4, WallClock())) as board:
        driver = get_driver("modbus")(board.port, 4, WallClock())
        board.faults.late = 0.6
        with pytest.raises(SilentBoardError):
            driver.read_states()
        assert wait(lambda: waiting_bytes(board) == len(board.sent) > 0)
        board.faults.late = 0.0
        driver.read_states()
        driver.close()
        late = logged(log, "dropped from", board.port)
        # The board notes an answer after it has sent it.
        assert late != b""
        assert wait(lambda: board.sent == late + logged(log, "from", board.port))


def test_the_log_has_the_bytes_of_the_sensor(log):
    sensor = recording(EmulatedCurrentSensor)("ina226", [1, 2], lambda channel, t: (1.5, 3.0), WallClock())
    with served(sensor):
        driver = CurrentSensor(sensor.port, "ina226", [1, 2], WallClock())
        assert driver.measure().currents[1] == pytest.approx(1.5, rel=0.05)
        driver.close()
        # The sensor enters what it has read after it has answered.
        assert wait(lambda: logged(log, "to", sensor.port) == sensor.received != b"")
        assert wait(lambda: logged(log, "from", sensor.port) == sensor.sent != b"")


def test_frames_past_the_lock_are_logged(log):
    with served(recording(get_emulator("lcus"))(4, WallClock())) as board:
        port = UnlockedPort(board.port)
        port.send(b"\xa0\x01\x00\xa1", 9600, is_held=False)
        port.close()
        board.wait_for_bytes(4)
        assert logged(log, "to", board.port) == board.received == b"\xa0\x01\x00\xa1"
        assert {r.name for r in log.records} == {UNLOCKED}


def test_a_frame_of_text_is_shown_as_text_too(log):
    with served(get_emulator("numato")(4, WallClock())) as board:
        driver = get_driver("numato")(board.port, 4, WallClock())
        driver.send({1: True})
        driver.close()
        lines = [r.getMessage() for r in log.records if r.levelno == logging.DEBUG]
    assert lines[0] == rf"to {board.port}: 72 65 6c 61 79 20 6f 6e 20 30 0d  'relay on 0\r'"
    assert lines[1].startswith(f"from {board.port}: 72 65 6c 61 79 20 6f 6e 20 30 0")
    assert "relay on 0" in lines[1].rpartition("  ")[2]


def test_nothing_is_formatted_where_nobody_looks(caplog):
    caplog.set_level(logging.INFO, LINE)
    with served(get_emulator("lcus")(4, WallClock())) as board:
        driver = get_driver("lcus")(board.port, 4, WallClock())
        driver.all_off()
        driver.close()
        said = [r.getMessage() for r in caplog.records if r.name == LINE]
    assert said == [f"opened {board.port} at 9600 baud", f"closed {board.port}"]
