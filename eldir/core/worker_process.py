"""A worker process: computes one function while this process goes on.

The engine's kernels hold the interpreter's lock, so a thread does not help. The worker is a new interpreter
and not a copy of this process, so a script without `if __name__ == "__main__"` is not run twice.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from types import TracebackType
from typing import Any

from eldir.core import program_log
from eldir.errors import EldirError


class WorkerProcess:
    """A process that starts when a `with` block is entered and is killed when the block is left. `begin`
    starts one computation, `value` waits for its result."""

    def __init__(self, module: str):
        """`module` is imported by the worker at once, before there is anything to compute."""
        self._module = module

    def __enter__(self) -> WorkerProcess:
        call = [sys.executable, "-c", f"from {__name__} import _serve; _serve({self._module!r})"]
        self._child = subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._child.kill()
        self._child.communicate()

    def begin(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Compute `function(*arguments)` in the worker; `function` must be at the top level of a module."""
        assert self._child.stdin is not None
        pickle.dump((function, arguments), self._child.stdin)
        self._child.stdin.flush()

    def value(self) -> Any:
        """Wait for the result and return it. An exception of the function is raised here. Raises `EldirError`
        if the worker died."""
        said, _ = self._child.communicate()
        if not said:
            raise EldirError(
                "the process that predicts motions died",
                found=f"exit status {self._child.returncode}",
                remedy="is there memory left?",
            )
        good, value = pickle.loads(said)
        if not good:
            raise value
        return value


def _serve(module: str) -> None:
    """Runs in the worker: receives one call and sends its result."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever is printed must not get into the answer
    program_log.configure("worker")
    try:
        import_module(module)
        function, arguments = pickle.load(sys.stdin.buffer)
        said = (True, function(*arguments))
    except EOFError:  # nobody asked
        return
    except BaseException as error:
        said = (False, error)
    pickle.dump(said, answer)
    answer.flush()
