"""The virtual robot in a worker process: its engine would block the other threads of this one."""

from __future__ import annotations

import signal
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir_hardware.virtual.bodies import Physics


class BodyProcess:
    """A `DrivenBody` of the virtual rig in a process of its own; ready when the constructor returns."""

    def __init__(
        self,
        physics: Physics,
        morphology: Morphology,
        seed: int,
        springs: SpringParameters,
        ballast: FloatArray,
        built: BuiltParameters | None = None,
    ):
        """The robot of `bodies.virtual_body`, which has the same parameters and errors."""
        context = get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(other, physics, morphology, seed, springs, ballast, built), daemon=True
        )
        self._process.start()
        other.close()
        self.remark = ""
        self.springs, self.positions = self._receive()

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Follow free lengths of the active springs given every `interval` [s], shape (steps, motors)."""
        self._connection.send((lengths, interval))
        self.positions, self.remark = self._receive()

    def close(self) -> None:
        """End the worker process."""
        self._process.kill()
        self._process.join()
        self._connection.close()

    def __enter__(self) -> BodyProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _receive(self) -> Any:
        try:
            found = self._connection.recv()
        except (EOFError, ConnectionError):
            raise EldirError("the virtual robot's process died") from None
        if isinstance(found, EldirError):
            raise found
        return found


def _serve(
    connection: Connection,
    physics: Physics,
    morphology: Morphology,
    seed: int,
    springs: SpringParameters,
    ballast: FloatArray,
    built: BuiltParameters | None,
) -> None:
    # The parent process needs none of these: the engine takes seconds to import.
    import numpy as np

    from eldir.core import program_log
    from eldir_hardware.virtual.bodies import virtual_body

    program_log.configure("virtual robot")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    try:
        # Another body moves for a moment: the engine compiles now.
        spare = virtual_body(physics, morphology, seed, springs, ballast, built)
        spare.move(np.full((1, morphology.motors), springs.cold_length), 0.05)
        body = virtual_body(physics, morphology, seed, springs, ballast, built)
        connection.send((body.springs, body.positions))
        while True:
            body.move(*connection.recv())
            connection.send((body.positions, body.remark))
    except EOFError:
        return
    except EldirError as error:
        connection.send(error)
