"""`python -m benchmarks --out DIR [--released CODE]`: all comparisons at hand, as JSON, plot and table."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmarks.comparisons import against_c, against_jax, against_released
from benchmarks.picture import plot, table
from benchmarks.printed import against_mujoco
from eldir.benchmark.other_programs import watch_other_programs
from eldir.core.files import new_folder, require_new
from eldir.core.installation import describe
from eldir.errors import EldirError


def main() -> int:
    """Status 0 if every comparison that was asked for was made."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="See benchmarks/README.md.")
    parser.add_argument("--out", type=Path, required=True, help="new folder")
    parser.add_argument("--released", type=Path, metavar="CODE", help="folder with the paper's released code")
    parser.add_argument("--turns", type=int, default=7, help="turns of each comparison")
    parser.add_argument("--robots", type=int, default=12, help="robots of each comparison")
    arguments = parser.parse_args()
    if arguments.turns < 1 or arguments.robots < 1:
        parser.error("turns and robots must be at least 1")
    try:
        require_new(arguments.out)
        with tempfile.TemporaryDirectory() as scratch, new_folder(arguments.out) as draft:
            with watch_other_programs() as others:
                results = _measure(arguments, Path(scratch))
            results["other_programs"] = others.share
            (draft / "benchmarks.json").write_text(json.dumps(results, indent=1) + "\n")
            (draft / "benchmarks.md").write_text(table(results))
            plot(results).savefig(draft / "benchmarks.png", dpi=150)
    except EldirError as error:
        print(f"benchmarks: {error}", file=sys.stderr)
        return 1
    print(table(results))
    print(others.describe())
    return 0


def _measure(arguments: argparse.Namespace, scratch: Path) -> dict[str, Any]:
    comparisons: dict[str, Callable[[], dict[str, Any]]] = {
        f"C, {kind} robots": partial(against_c, kind, arguments.robots, arguments.turns, scratch)
        for kind in ("big", "small")
    }
    if find_spec("jax") is None:
        print("JAX is left out: pip install jax", file=sys.stderr)
    else:
        comparisons |= {
            f"JAX, {kind} robots": partial(against_jax, kind, arguments.robots, arguments.turns, scratch)
            for kind in ("big", "small")
        }
    if arguments.released is None:
        print("the released code is left out: no --released CODE (benchmarks/README.md)", file=sys.stderr)
    else:
        comparisons["released code, big robots"] = partial(
            against_released, arguments.released.resolve(), "big", arguments.robots, arguments.turns, scratch
        )
    if find_spec("mujoco") is None:
        print("MuJoCo is left out: pip install 'eldir[mujoco]'", file=sys.stderr)
    else:  # a walk takes seconds there
        comparisons["MuJoCo, printed robots"] = partial(against_mujoco, 2, max(1, arguments.turns // 3))
    compared = {}
    for name, compare in comparisons.items():
        print(f"{name} ...", file=sys.stderr)
        before = os.getloadavg()[0]
        compared[name] = {**compare(), "load_average": [round(before, 1), round(os.getloadavg()[0], 1)]}
    machine = describe()
    # Results are published: nothing about a person's folders.
    del (
        machine["eldir"]["folder"],
        machine["variables"],
    )
    return {"measured": datetime.now(UTC).date().isoformat(), "machine": machine, "comparisons": compared}


if __name__ == "__main__":
    sys.exit(main())
