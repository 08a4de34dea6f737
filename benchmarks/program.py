"""A program in a process of its own, which does the task once whenever it is asked."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import numpy as np

from eldir.core.records import FloatArray
from eldir.errors import EldirError


class Program:
    """`call` starts it; it reads a line, does the task, and answers in a line: seconds by
    the clock, of processor time, and the first losses."""

    def __init__(self, call: Sequence[str | Path], output: Path):
        self._output = output
        with output.open("w") as errors:
            self._process = subprocess.Popen(
                list(map(str, call)), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
            )

    def __enter__(self) -> Program:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.communicate()

    def turn(self) -> tuple[tuple[float, float], FloatArray]:
        """Seconds by the clock and of processor time, and the losses of the first pass [m]."""
        assert self._process.stdin and self._process.stdout
        try:
            self._process.stdin.write("go\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            last = self._output.read_text().strip().splitlines()[-1:]
            raise EldirError("a program ended before its answer", found=" ".join(last) or "no output")
        seconds, spent, losses = json.loads(line)
        return (seconds, spent), np.array(losses)
