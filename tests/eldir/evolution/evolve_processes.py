"""`eldir evolve` in a process of its own, and the bytes of its folder."""

import os
import subprocess
import sys
from pathlib import Path

from tests.forked_programs import Forked

SMALL = ["--lattice", "4x6", "--max-motors", "2", "--population", "6", "--iterations", "3", "--seed", "3"]
_CODE = "from eldir_app.commands.evolve import evolve; import typer; typer.run(evolve)"


def start(*arguments: str | Path, threads: int = 1) -> Forked:
    return Forked(
        [sys.executable, "-c", _CODE, *map(str, arguments)],
        env=os.environ | {"ELDIR_THREADS": str(threads)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def contents(path: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(path.iterdir())}
