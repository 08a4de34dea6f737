"""What a worker process computes in tests; it imports this module and all that this imports."""

from __future__ import annotations

import os
import signal

from eldir.errors import InputError


def square(x: float) -> float:
    print("this must not get into the answer")
    return x * x


def refuse(what: str) -> None:
    raise InputError(f"no {what}", expected="some", found="none")


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def interrupted(x: float) -> float:
    """Ctrl-C in the terminal of both processes."""
    os.kill(os.getpid(), signal.SIGINT)
    return x * x
