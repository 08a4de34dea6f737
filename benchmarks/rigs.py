"""`python -m benchmarks.rigs DESIGN... --out FOLDER`: designs on rigs that they have never seen.

A rig's springs, feet, parts and supply are drawn from its seed, and MuJoCo moves the robot. The program's
own commands do everything: `rig new`, `gait`, `rig drive`, `report`. The prediction knows only the rig file.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from eldir.core.files import new_folder, require_new
from eldir.errors import EldirError

_ELDIR = [sys.executable, "-m", "eldir"]


def main() -> int:
    """Status 0 if every film was made, whatever it shows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.rigs", description=__doc__.split("\n")[0])
    parser.add_argument("designs", type=Path, nargs="+", metavar="DESIGN", help="design with an evolved gait")
    parser.add_argument("--out", type=Path, required=True, help="new folder")
    parser.add_argument("--seeds", type=int, nargs="+", default=[101, 102, 103, 104, 105], help="of the rigs")
    parser.add_argument("--far", action="store_true", help="parameters that are 10 to 50 % off")
    parser.add_argument("--processes", type=int, default=1, help="films at the same time")
    arguments = parser.parse_args()
    try:
        require_new(arguments.out)
        tasks = [(design, seed, arguments.far) for design in arguments.designs for seed in arguments.seeds]
        with new_folder(arguments.out) as draft, ThreadPoolExecutor(arguments.processes) as pool:
            films = list(pool.map(lambda task: filmed(*task), tasks))
            (draft / "rigs.json").write_text(json.dumps(films, indent=1) + "\n")
            (draft / "rigs.md").write_text(table(films))
    except EldirError as error:
        print(f"benchmarks.rigs: {error}", file=sys.stderr)
        return 1
    print(table(films))
    return 0


def filmed(design: Path, seed: int, far: bool) -> dict[str, Any]:
    """The walk of a design on one rig [body lengths per five cycles]: predicted, its interval, and filmed."""
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        shutil.copy(design, here / "design.json")
        _run("rig", "new", "--seed", str(seed), "--design", "design.json", "--out", "rig.yaml", here=here)
        if far:
            rig = here / "rig.yaml"
            rig.write_text(rig.read_text().replace("\nvirtual:\n", "\nvirtual:\n  parameter_spread: large\n"))
        _run("gait", "design.json", "--rig", "rig.yaml", "--out", "schedule.json", here=here)
        _run("rig", "drive", "schedule.json", "--rig", "rig.yaml", "--log", "log.mcap", here=here)
        said = _run("report", "log.mcap", "--design", "design.json", "--out", "report", "--json", here=here)
    report = json.loads(said)
    result = {
        "design": f"{design.parent.name}/{design.name}",
        "rig": seed,
        "parameter_spread": "large" if far else "small",
        "predicted": report["body_lengths_per_5_cycles"]["predicted"],
        "interval": report["body_lengths_per_5_cycles_interval"]["predicted"],
        "filmed": report["body_lengths_per_5_cycles"]["tracked"],
    }
    print(json.dumps(result), file=sys.stderr, flush=True)
    return result


def _run(*command: str, here: Path) -> str:
    done = subprocess.run([*_ELDIR, *command], cwd=here, capture_output=True, text=True, check=False)
    if done.returncode:
        raise EldirError(f"eldir {' '.join(command)} failed", found=done.stderr.strip())
    return done.stdout


def table(films: Sequence[dict[str, Any]]) -> str:
    """Markdown: a row for each film."""
    lines = [
        "| design | rig | predicted | interval | filmed | inside |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for film in films:
        low, high = film["interval"]
        inside = "yes" if low <= film["filmed"] <= high else "**no**"
        lines.append(
            f"| {film['design']} | {film['rig']}, {film['parameter_spread']} | {film['predicted']:+.2f} | "
            f"{low:+.2f} to {high:+.2f} | {film['filmed']:+.2f} | {inside} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
