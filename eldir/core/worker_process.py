"""Something computed by another Python process while this one goes on.

The engine's kernels hold the interpreter's lock, so a thread would not do; and the process is started
bare, not as a copy of this one, so a script that has no `if __name__ == "__main__"` is not run twice.
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

from eldir.errors import EldirError


class WorkerProcess:
    """A process that gets ready at once, is told what to compute, and is asked for it; use it in a `with`."""

    def __init__(self, module: str):
        """`module` is imported first, while nobody waits."""
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
        """Compute `function(*arguments)`; a function of a module."""
        assert self._child.stdin is not None
        pickle.dump((function, arguments), self._child.stdin)
        self._child.stdin.flush()

    def value(self) -> Any:
        """What was computed; what was raised is raised here."""
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
    """The other process."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever is printed must not get into the answer
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
