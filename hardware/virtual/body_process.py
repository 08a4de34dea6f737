"""The virtual robot in a worker process: its engine would block the other threads of this one."""

from __future__ import annotations

import signal
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.parameters.springs import SpringParameters
from hardware.virtual.bodies import Physics


class BodyProcess:
    """A `hardware.virtual.rig.DrivenBody` in a process of its own; ready when the constructor returns."""

    def __init__(self, design: Path, seed: int, springs: SpringParameters, physics: Physics = "eldir"):
        """The built robot of a design file; raises `EldirError` where the file is damaged."""
        context = get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(other, design, seed, springs, physics), daemon=True
        )
        self._process.start()
        other.close()
        self.remark = ""
        self.springs, self.positions = self._receive()

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Follow free lengths of the active springs given every `interval` [s], shape (steps, motors)."""
        self._connection.send((lengths, interval))
        self.positions = self._receive()

    def close(self) -> None:
        """End the worker process."""
        self._process.kill()
        self._process.join()

    def _receive(self) -> Any:
        try:
            found = self._connection.recv()
        except EOFError:
            raise EldirError("the virtual robot's process died") from None
        if isinstance(found, EldirError):
            raise found
        return found


def _serve(
    connection: Connection, path: Path, seed: int, springs: SpringParameters, physics: Physics
) -> None:
    # The parent process needs none of these: the engine takes seconds to import.
    import numpy as np

    from eldir.design import Design
    from hardware.virtual.bodies import virtual_body

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    try:
        design = Design.load(path)
        body = virtual_body(physics, design.morphology, seed, springs, design.ballast)
        # A moment without heat: the engine compiles now.
        body.move(np.full((1, design.morphology.motors), springs.cold_length), 0.05)
        connection.send((body.springs, body.positions))
        while True:
            body.move(*connection.recv())
            connection.send(body.positions)
    except EOFError:
        return
    except EldirError as error:
        connection.send(error)
