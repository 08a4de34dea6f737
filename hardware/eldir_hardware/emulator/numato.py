"""An emulated Numato relay module, written from its manual."""

from __future__ import annotations

from collections.abc import Callable

from eldir_hardware.clock import Clock
from eldir_hardware.emulator.board import ContactEvent, EmulatedBoard

_LINE_BREAK = "\n\r"


class EmulatedNumato(EmulatedBoard):
    """Echoes every line, obeys it if it is a known command, and prompts for the next line.

    The width of masks on modules of fewer than eight channels is not documented: `digits` selects it.
    """

    def __init__(
        self, channels: int, clock: Clock, on_contact_event: Callable[[ContactEvent], None] | None = None
    ):
        super().__init__(channels, clock, on_contact_event)
        self.digits = (channels + 7) // 8 * 2

    def request_length(self, data: bytes) -> int:
        return data.find(b"\r") + 1

    def obey(self, request: bytes) -> bytes:
        line = request.decode("latin-1").rstrip("\r")
        value = self._execute(line.split())
        echo = line if value is None else line + _LINE_BREAK + value
        return (echo + _LINE_BREAK + ">").encode("latin-1")

    def _execute(self, words: list[str]) -> str | None:
        match words:
            case ["ver"]:
                return "00000008"
            case ["id", "get"]:
                return "00000000"
            case ["reset"]:
                self._write(0)
            case ["relay", "on" | "off" as verb, number] if number in self._relay_names():
                self.set_coil(self._relay_names().index(number) + 1, verb == "on")
            case ["relay", "read", number] if number in self._relay_names():
                return "on" if self.coils[self._relay_names().index(number)] else "off"
            case ["relay", "readall"]:
                bits = "".join("1" if on else "0" for on in reversed(self.coils))
                return format(int(bits, 2), "x").zfill(self.digits)
            case ["relay", "writeall", mask] if len(mask) == self.digits and set(mask) <= set(
                "0123456789abcdef"
            ):
                self._write(int(mask, 16))
        return None

    def _write(self, mask: int) -> None:
        for i in range(self.channels):
            self.set_coil(i + 1, mask // 2**i % 2 == 1)

    def _relay_names(self) -> list[str]:
        return list("0123456789ABCDEF"[: self.channels])
