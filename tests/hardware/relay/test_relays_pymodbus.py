"""Our Modbus drivers against pymodbus's server, which knows nothing of us: RTU and ASCII."""

import asyncio
import os
import threading
import tty
from contextlib import contextmanager, suppress
from select import select

import pytest
from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer
from pymodbus.simulator import DataType, SimData, SimDevice

from eldir_hardware.clock import WallClock
from eldir_hardware.relay.modbus import ModbusBoard
from eldir_hardware.relay.sainsmart import SainSmartBoard


@contextmanager
def linked_terminals():
    """Two ports, each of which hears what the other says."""
    pairs = [os.openpty() for _ in range(2)]
    for handle in (h for pair in pairs for h in pair):
        tty.setraw(handle)
    stop_read, stop_write = os.pipe()

    def carry() -> None:
        other = {pairs[0][0]: pairs[1][0], pairs[1][0]: pairs[0][0]}
        while True:
            ready, _, _ = select([*other, stop_read], [], [])
            if stop_read in ready:
                return
            for handle in ready:
                os.write(other[handle], os.read(handle, 4096))

    thread = threading.Thread(target=carry)
    thread.start()
    try:
        yield [os.ttyname(guest) for _, guest in pairs]
    finally:
        os.write(stop_write, b".")
        thread.join()
        for handle in (*(h for pair in pairs for h in pair), stop_read, stop_write):
            os.close(handle)


@contextmanager
def served(port: str, unit: int, framer: FramerType):
    """A server of 32 coils in a thread."""
    ready, loop = threading.Event(), asyncio.new_event_loop()
    tasks = []

    async def serve() -> None:
        none = [SimData(0, values=0, datatype=DataType.REGISTERS)]
        coils = [SimData(0, values=[False] * 32, datatype=DataType.BITS)]
        server = ModbusSerialServer(
            SimDevice(unit, (coils, coils, none, none)), framer=framer, port=port, baudrate=9600
        )
        tasks.append(asyncio.current_task())
        await server.serve_forever(background=True)
        ready.set()
        with suppress(asyncio.CancelledError):
            await asyncio.sleep(60)
        await server.shutdown()

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()))
    thread.start()
    assert ready.wait(10)
    try:
        yield
    finally:
        loop.call_soon_threadsafe(tasks[0].cancel)
        thread.join(10)
        loop.close()


@pytest.mark.parametrize(
    ("driver", "unit", "framer"),
    [(ModbusBoard, 1, FramerType.RTU), (SainSmartBoard, 254, FramerType.ASCII)],
)
def test_a_server_that_we_did_not_write_understands_us(driver, unit, framer):
    with linked_terminals() as (theirs, ours), served(theirs, unit, framer):
        board = driver(ours, 8, WallClock())
        assert board.read_states() == (False,) * 8
        assert board.switch({2: True, 8: True}) == (False, True) + (False,) * 5 + (True,)
        assert board.switch({2: False}) == (False,) * 7 + (True,)
        if driver is SainSmartBoard:  # RTU boards have an all-off coil of their own making
            board.all_off()
            assert board.read_states() == (False,) * 8
        board.close()
