"""Your own relay board: a driver and an emulator. `!21` closes channel 2, `!20` opens it, `?` asks all."""

from hardware.clock import WallClock
from hardware.emulator.board import EmulatedBoard
from hardware.relay.board import RelayBoard
from hardware.relay.registration import Board


class ToyBoard(RelayBoard):
    command_length = 3

    def _command(self, channel: int, closed: bool) -> None:
        self._line.write(b"!%d%d" % (channel, closed))

    def _report(self) -> tuple[bool, ...]:
        return tuple(digit == ord("1") for digit in self._line.ask(b"?", 1 + self.channels)[1:])

    def _report_time(self) -> float:
        return self._line.wire_time(2 + self.channels)


class EmulatedToy(EmulatedBoard):
    def _request_length(self, data: bytes) -> int:
        return len(data[:1]) if data[:1] != b"!" else 3 * (len(data) >= 3)

    def _obey(self, request: bytes) -> bytes:
        if len(request) == 3:
            self._set_coil(request[1] - 48, request[2:] == b"1")
        return b"=" + bytes(48 + on for on in self._coils) if request == b"?" else b""


# For rig files, name this in your package's pyproject.toml: [project.entry-points."eldir.boards"]
BOARD = Board(ToyBoard, f"{__name__}:EmulatedToy", most_channels=9)
emulated = EmulatedToy(4, WallClock())
board = ToyBoard(emulated.start(), 4, WallClock())
with board.armed():  # all contacts are open before and after
    print("contact 2 closed:", board.switch({2: True}))
board.close()
print("the emulated board's own contacts:", emulated.contacts)
emulated.close()
