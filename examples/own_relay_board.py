"""Your own relay board. `!21` closes channel 2, `!20` opens it; `?` asks all, and is answered twice."""

from eldir_hardware.clock import WallClock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import GarbledReplyError
from eldir_hardware.relay.registration import Board


class ToyBoard(RelayBoard):
    command_length = 3  # of `!21`, which has no answer
    max_relays = 9  # all-off opens them all, also where the rig file says fewer channels
    _relays = 0  # not known before the first report

    def _command(self, channel: int, closed: bool) -> None:
        self._line.write(b"!%d%d" % (channel, closed))

    def _report(self) -> tuple[bool, ...]:  # those beyond `channels` too: none may stay closed unnoticed
        answer = self._line.query_until(b"?", b"\n", 2 + 2 * self.max_relays)
        states = tuple(digit == ord("1") for digit in answer[1 : len(answer) // 2])
        sound = b"=%b%b\n" % (bytes(48 + s for s in states), bytes(49 - s for s in states))
        if answer != sound or len(states) < self.channels:
            raise GarbledReplyError("the toy board's answer cannot be read", found=repr(answer))
        self._relays = len(states)
        return states

    def _report_time(self) -> float:
        return self._line.wire_time(3 + 2 * (self._relays or self.channels))


class EmulatedToy(EmulatedBoard):
    def request_length(self, data: bytes) -> int:
        return len(data[:1]) if data[:1] != b"!" else 3 * (len(data) >= 3)

    def obey(self, request: bytes) -> bytes:
        if len(request) == 3:
            self.set_coil(request[1] - 48, request[2:] == b"1")
        digits = "".join("01"[on] for on in self.coils)
        return f"={digits}{digits.translate({48: '1', 49: '0'})}\n".encode() if request == b"?" else b""


BOARD = Board(ToyBoard, f"{__name__}:EmulatedToy", max_channels=9)  # for an entry point
if __name__ == "__main__":
    emulated = EmulatedToy(8, WallClock())
    board = ToyBoard(emulated.start(), 4, WallClock())
    with board.armed():  # all contacts are open before and after
        print("contact 2 closed:", board.switch({2: True}))
    board.close()
    print("the emulated board's own contacts:", emulated.contacts)
    emulated.close()
