"""The examples' page: each script, and the output of those that draw, which run while the site is built."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

_DRAW = ("drive_printed_robot", "rugged_ground")


def run(docs: Path) -> None:
    """Run the examples that draw; outputs and pictures go to docs/generated/examples/."""
    folder = docs / "generated" / "examples"
    shutil.rmtree(folder, ignore_errors=True)
    for name in _DRAW:
        place = folder / name
        place.mkdir(parents=True)
        script = docs.parent / "examples" / f"{name}.py"
        result = subprocess.run(
            [sys.executable, str(script)],
            env=os.environ | {"TMPDIR": str(place), "ELDIR_THREADS": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        if result.returncode:
            raise RuntimeError(f"{script} failed:\n{result.stderr}")
        (picture,) = place.rglob("*.png")
        picture.rename(folder / f"{name}.png")
        output = result.stdout.replace(f"{picture.parent}/", "/tmp/")
        (folder / f"{name}.txt").write_text(output, encoding="utf-8")
        shutil.rmtree(place)


def examples_markdown(docs: Path) -> str:
    """The Markdown of all examples."""
    parts = []
    for script in sorted((docs.parent / "examples").glob("*.py")):
        code = script.read_text(encoding="utf-8").rstrip()
        parts.append(f"\n\n## {script.name}\n\n```python\n{code}\n```\n")
        output = docs / "generated" / "examples" / f"{script.stem}.txt"
        if output.exists():
            parts.append(f"\nIt prints:\n\n```text\n{output.read_text(encoding='utf-8').rstrip()}\n```\n")
            parts.append(f"\n![What {script.name} draws](generated/examples/{script.stem}.png)\n")
    return "".join(parts)
