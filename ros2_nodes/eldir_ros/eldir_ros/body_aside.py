"""The virtual robot in a process of its own: its engine lets no other thread run for too long."""

from __future__ import annotations

import signal
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.parameters.springs import SpringParameters


class BodyAside:
    """A `hardware.virtual.rig.DrivenBody`: the design's built robot, ready to move when this returns."""

    def __init__(self, design: Path, seed: int, springs: SpringParameters):
        context = get_context("spawn")
        self._there, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, design, seed, springs), daemon=True)
        self._process.start()
        other.close()
        self.springs, self.positions = self._receive()

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Follow free lengths of the active springs given every `interval` [s], shape (steps, motors)."""
        self._there.send((lengths, interval))
        self.positions = self._receive()

    def close(self) -> None:
        """End its process."""
        self._process.kill()
        self._process.join()

    def _receive(self):  # type: ignore[no-untyped-def]
        try:
            found = self._there.recv()
        except EOFError:
            raise EldirError("the virtual robot's process died") from None
        if isinstance(found, EldirError):
            raise found
        return found


def _serve(there: Connection, path: Path, seed: int, springs: SpringParameters) -> None:
    import numpy as np

    from eldir.design import Design
    from hardware.virtual.body import BuiltBody

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends us
    try:
        design = Design.load(path)
        body = BuiltBody(design.morphology, seed, springs, design.ballast / 2)
        # A moment without heat: the engine compiles now.
        body.move(np.full((1, design.morphology.motors), springs.cold_length), 0.05)
        there.send((body.springs, body.positions))
        while True:
            body.move(*there.recv())
            there.send(body.positions)
    except EOFError:
        return
    except EldirError as error:
        there.send(error)
