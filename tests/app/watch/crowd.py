"""Many connections that keep a server busy and never let a request end: a process of its own.

    python -m tests.app.watch.crowd PORT KIND COUNT ADDRESSES

It prints a line when all have tried to connect, and goes on until it is killed, for at most `_MAX_S`. A
connection that the server ends is opened again. The connections come from so many addresses of 127.0.0.0/8.
"""

import asyncio
import itertools
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_MAX_S = 40.0
_DRIP_S = 0.5  # from one byte to the next
_PAUSE_S = 0.3  # before a connection is opened again
_HEAD = "GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n{more}"
_UPGRADE = (
    "Origin: http://127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n{end}"
)
_SPEECH = bytes([0x81, 0x82, 0, 0, 0, 0]) + b"hi"  # a masked message; a page says nothing

# First bytes, the bytes that drip afterwards, and whether answers are read.
KINDS: dict[str, tuple[str, bytes, bool]] = {
    "silent": ("", b"", True),
    "slow head": (_HEAD.format(path="/", port="{port}", more="X-"), b"a", True),
    "slow body": (_HEAD.format(path="/", port="{port}", more="Content-Length: 100000\r\n\r\n"), b"a", True),
    "chunked body": (
        _HEAD.format(path="/", port="{port}", more="Transfer-Encoding: chunked\r\n\r\n"), b"1\r\na\r\n", True,
    ),
    "huge body": (
        _HEAD.format(path="/", port="{port}", more="Content-Length: 99999999999\r\n\r\n"), b"a" * 2000, True,
    ),
    "body of a stop": (
        "POST /stop HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Length: 100000\r\n\r\n", b"a", True,
    ),
    "pipelined unread": (_HEAD.format(path="/page.js", port="{port}", more="\r\n") * 50, b"", False),
    "kept alive": (
        _HEAD.format(path="/", port="{port}", more="\r\n"),
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", True,
    ),
    "half an upgrade": (
        _HEAD.format(path="/socket", port="{port}", more=_UPGRADE.format(port="{port}", end="")), b"", True,
    ),
    "upgrade that speaks": (
        _HEAD.format(path="/socket", port="{port}", more=_UPGRADE.format(port="{port}", end="\r\n")),
        _SPEECH, False,
    ),
}  # fmt: skip


@contextmanager
def crowd(port: int, kind: str, count: int = 1024, addresses: int = 1) -> Iterator[None]:
    """The process, from when all its connections were opened once."""
    words = [sys.executable, "-m", __name__, str(port), kind, str(count), str(addresses)]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None and process.stdout.readline()
            yield
        finally:
            process.kill()


async def _connect(
    number: int, port: int, kind: str, addresses: int, opening: asyncio.Semaphore, tried: asyncio.Semaphore
) -> None:
    first, drip, is_read = KINDS[kind]
    source = f"127.0.{1 + number % addresses // 250}.{1 + number % addresses % 250}"
    for attempt in itertools.count():
        with suppress(OSError):
            async with opening:
                pair = asyncio.open_connection("127.0.0.1", port, local_addr=(source, 0), limit=1 << 16)
                try:
                    reader, writer = await asyncio.wait_for(pair, 5.0)
                except TimeoutError:
                    continue
                finally:
                    if not attempt:
                        tried.release()
                if not is_read:
                    writer.transport.pause_reading()
                writer.write(first.replace("{port}", str(port)).encode())
                await asyncio.sleep(0.05)  # the server reads before more come
            reading = asyncio.create_task(reader.read())
            while not (reading.done() or writer.is_closing()):
                await asyncio.sleep(_DRIP_S)
                writer.write(drip)
            reading.cancel()
            writer.transport.abort()
        await asyncio.sleep(_PAUSE_S)


async def _all(port: int, kind: str, count: int, addresses: int) -> None:
    os.nice(10)  # a crowd would sit at other computers
    opening, tried = asyncio.Semaphore(64), asyncio.Semaphore(0)
    tasks = [asyncio.create_task(_connect(n, port, kind, addresses, opening, tried)) for n in range(count)]
    for _ in tasks:
        await tried.acquire()
    print("all have tried", flush=True)
    await asyncio.sleep(_MAX_S)


if __name__ == "__main__":
    asyncio.run(_all(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4])))
