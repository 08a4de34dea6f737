"""Ctrl-C while modules are imported: held back until they are.

Some packages (trimesh) catch every exception of an import, KeyboardInterrupt included, and go on without the
module. The program would then drive to the end.
"""

from __future__ import annotations

import signal
from types import FrameType

_LATER = 0.05  # [s]


def hold_back_during_imports() -> None:
    """Postpone the first Ctrl-C past the import that it comes in. The second one interrupts at once."""
    if (
        signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):  # such as ignored, in the background
        return
    held = False

    def on_interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal held
        if held or not _importing(frame):
            raise KeyboardInterrupt
        held = True
        signal.setitimer(signal.ITIMER_REAL, _LATER, _LATER)

    def on_time(number: int, frame: FrameType | None) -> None:
        if not _importing(frame):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.raise_signal(signal.SIGINT)

    signal.signal(signal.SIGINT, on_interrupt)
    signal.signal(signal.SIGALRM, on_time)


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
