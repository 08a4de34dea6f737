"""A pseudo-terminal in place of a serial port."""

import os
import pty
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def terminal() -> Iterator[tuple[int, str]]:
    """File descriptor of the board's end, and name of the port."""
    host, guest = pty.openpty()
    try:
        yield host, os.ttyname(guest)
    finally:
        os.close(host)
        os.close(guest)
