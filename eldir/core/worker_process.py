"""A worker process: computes one function while this process goes on.

The engine's kernels hold the interpreter's lock, so a thread does not help. The worker is a new interpreter
and not a copy of this process, so a script without `if __name__ == "__main__"` is not run twice.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from types import TracebackType
from typing import Any

from eldir.core import program_log
from eldir.errors import EldirError


class WorkerProcess:
    """A process that starts when a `with` block is entered and is killed when the block is left. `begin`
    starts a computation, `value` waits for its result; then the next may begin."""

    def __init__(self, module: str, environment: Mapping[str, str] | None = None):
        """`module` is imported by the worker at once, before there is anything to compute. `environment` are
        further variables of its environment."""
        self._module = module
        self._environment = {**os.environ, **(environment or {})}

    def __enter__(self) -> WorkerProcess:
        call = [sys.executable, "-c", f"from {__name__} import _run_worker; _run_worker({self._module!r})"]
        self._child = subprocess.Popen(
            call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=self._environment
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._child.kill()
        self._child.communicate()

    def begin(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Compute `function(*arguments)` in the worker; `function` must be at the top level of a module."""
        assert self._child.stdin is not None
        try:
            pickle.dump((function, arguments), self._child.stdin, protocol=5)
            self._child.stdin.flush()
        except BrokenPipeError:
            pass  # `value` says that it died

    def value(self) -> Any:
        """Wait for the result and return it. An exception of the function is raised here. Raises `EldirError`
        if the worker died."""
        assert self._child.stdout is not None
        try:
            good, value = pickle.load(self._child.stdout)
        except (EOFError, pickle.UnpicklingError):
            raise EldirError(
                f"the process that computes in {self._module} died",
                found=f"exit status {self._child.wait()}",
                remedy="check the free memory",
            ) from None
        if not good:
            raise value
        return value


def _run_worker(module: str) -> None:
    """Runs in the worker: receives calls and sends their results, until its input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C here too; the caller decides
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever is printed must not get into the answer
    program_log.configure("worker")
    failed: BaseException | None = None
    try:
        import_module(module)
    except BaseException as error:
        failed = error
    while True:
        try:
            function, arguments = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        except BaseException as error:
            answer = (False, error)
        else:
            try:
                if failed is not None:
                    raise failed
                answer = (True, function(*arguments))
            except BaseException as error:
                answer = (False, error)
        pickle.dump(answer, output, protocol=5)
        output.flush()
