"""The microcontroller that measures currents and voltages: INA226 or INA3221 chips on I2C, lines on USB.

It runs on MicroPython, copied to an RP2040-class board as main.py, and unchanged in the emulated sensor.
Each request starts its own measurement, so an answer holds nothing older than the request. Values are counts
of the chips; the rig file has the shunts. Registers, counts and conversion times are those of the data sheets
(TI SBOS547 and SBOS576). The protocol is in docs/reference/sensor.md.
"""

MAKER_REGISTER = 0xFE
DIE_REGISTER = 0xFF
MAKER = 0x5449  # "TI"
MAX_REQUEST = 32  # bytes of a request; a longer line is noise


class Bus:
    """The I2C bus; the emulator has its own."""

    def read(self, address: int, register: int) -> int:
        """The 16 bits of a register. Raises OSError where no chip answers."""
        raise NotImplementedError

    def write(self, address: int, register: int, value: int) -> None:
        """Write the 16 bits of a register. Raises OSError where no chip answers."""
        raise NotImplementedError

    def wait(self, milliseconds: int) -> None:
        """Let time pass."""
        raise NotImplementedError


class Ina226:
    """One input. Four averages of 1.1 ms for shunt and bus, once for each write of the configuration."""

    name = "ina226"
    die = 0x2260
    addresses = range(0x40, 0x50)
    configuration = 0x4000 | 1 << 9 | 4 << 6 | 4 << 3 | 3
    ready_register, ready_bit = 0x06, 1 << 3
    inputs = 1
    unused_bits = 0
    shunt_nv, bus_uv = 2500, 1250  # one count
    window_us = 4 * 2 * 1210  # 10 % longer than nominal, as the data sheet allows


class Ina3221:
    """Three inputs, one after the other: four averages of 0.588 ms for each shunt and bus."""

    name = "ina3221"
    die = 0x3220
    addresses = range(0x40, 0x44)
    configuration = 0x7000 | 1 << 9 | 3 << 6 | 3 << 3 | 3
    ready_register, ready_bit = 0x0F, 1 << 0
    inputs = 3
    unused_bits = 3
    shunt_nv, bus_uv = 40000, 8000
    window_us = 4 * 6 * 646


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE; of b"123456789" it is 0x29B1."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1
        crc &= 0xFFFF
    return crc


def with_crc(text: str) -> bytes:
    """A line with its checksum and its end."""
    return f"{text}*{crc16(text.encode()):04X}\n".encode()


def to_signed(value: int) -> int:
    """16 bits as two's complement."""
    return value - 0x10000 if value & 0x8000 else value


class CurrentSensor:
    """All chips of one kind on a bus, in the order of their addresses."""

    def __init__(self, bus: Bus):
        self.bus = bus
        self.kind = Ina226
        self.chips = []  # type: list[int]

    def answer(self, line: bytes) -> bytes:
        """The answer to a line from the computer; empty for a line that is not a request."""
        try:
            text, check = line.decode().rstrip("\r\n").rsplit("*", 1)
            if check != f"{crc16(text.encode()):04X}":
                return b""
            request, sequence = text.split(" ")
        except ValueError:  # also where bytes are no text
            return b""
        if request == "I":
            return with_crc(f"I {sequence} {self.identify()}")
        if request == "M":
            return self.measure(sequence)
        return b""

    def identify(self) -> str:
        """Look for the chips: their kind, inputs, values of one count, duration of a measurement."""
        self.chips = []
        for kind in (Ina226, Ina3221):
            found = [a for a in kind.addresses if self.is_present(a, kind.die)]
            if found:
                self.kind = kind  # type: ignore[assignment]
                self.chips = found
                break
        kind = self.kind
        inputs = len(self.chips) * kind.inputs
        return f"{kind.name} {inputs} {kind.shunt_nv} {kind.bus_uv} {kind.window_us}"

    def is_present(self, address: int, die: int) -> bool:
        """Whether this chip answers at that address."""
        try:
            return self.bus.read(address, MAKER_REGISTER) == MAKER and (
                self.bus.read(address, DIE_REGISTER) == die
            )
        except OSError:
            return False

    def measure(self, sequence: str) -> bytes:
        """Start a measurement on all chips, wait until it is complete, and read it."""
        address = 0
        try:
            for address in self.chips:
                # Stops a running measurement and starts another.
                self.bus.write(address, 0, self.kind.configuration)
            waiting = list(self.chips)
            for _ in range(2 + self.kind.window_us // 1000):
                self.bus.wait(1)
                waiting = [a for a in waiting if not self.is_ready(a)]
                if not waiting:
                    break
            if waiting:
                return with_crc(f"E {sequence} slow {waiting[0]:02X}")
            counts = []
            for address in self.chips:
                for i in range(self.kind.inputs):
                    shunt, bus = (
                        to_signed(self.bus.read(address, 1 + 2 * i + k)) >> self.kind.unused_bits
                        for k in (0, 1)
                    )
                    counts.append(f"{shunt},{bus}")
        except OSError:
            return with_crc(f"E {sequence} lost {address:02X}")
        return with_crc(f"M {sequence} {' '.join(counts)}")

    def is_ready(self, address: int) -> bool:
        """Whether the measurement is complete; reading the flag clears it."""
        return bool(self.bus.read(address, self.kind.ready_register) & self.kind.ready_bit)


class I2cBus(Bus):
    """I2C 0 of an RP2040-class board on pins 4 (data) and 5 (clock), at 400 kHz."""

    def __init__(self) -> None:
        import machine

        self.i2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400_000)

    def read(self, address: int, register: int) -> int:
        return int.from_bytes(self.i2c.readfrom_mem(address, register, 2), "big")

    def write(self, address: int, register: int, value: int) -> None:
        self.i2c.writeto_mem(address, register, value.to_bytes(2, "big"))

    def wait(self, milliseconds: int) -> None:
        import time

        time.sleep_ms(milliseconds)  # type: ignore[attr-defined]


def main() -> None:
    """Answer requests for ever."""
    import sys

    import micropython

    micropython.kbd_intr(-1)  # a byte 3 in noise is not Ctrl-C
    sensor = CurrentSensor(I2cBus())
    sensor.identify()
    while True:
        answer = sensor.answer(sys.stdin.buffer.readline(MAX_REQUEST))
        if answer:
            sys.stdout.buffer.write(answer)


if __name__ == "__main__":  # MicroPython runs main.py under this name, too
    main()
