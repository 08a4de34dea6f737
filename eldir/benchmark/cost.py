"""Memory of many robots, and the time of the first use; each is measured in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile

_MEMORY = """
import json, resource, sys
from eldir.benchmark.populations import big
from eldir.learning import learn
from eldir.scene import Scene

def peak():
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 3)

learn(big(1), Scene(), 1)
begun = peak()
bodies = big(int(sys.argv[1]), seed=2)
bred = peak()
learn(bodies, Scene().replace(steps=10), 1)
print(json.dumps({"robots": len(bodies), "engine_gb": begun, "bodies_gb": bred, "peak_gb": peak()}))
"""
_FIRST_USE = """
import json, time
began = time.process_time()
from eldir.benchmark.populations import small
from eldir.learning import learn
from eldir.scene import Scene
bodies, scene = small(1), Scene().replace(steps=2)
from eldir.engine.runtime import start
start()
started = time.process_time()
learn(bodies, scene, 1)
print(json.dumps({"start_s": round(started - began, 2), "kernel_s": round(time.process_time() - started, 2)}))
"""


def memory(robots: int) -> dict[str, float]:
    """Peak memory [GB] with the engine started, with random bodies beside it, and after they learned."""
    return _ask(_MEMORY, [str(robots)], {})


def first_use() -> dict[str, dict[str, float]]:
    """Processor seconds until the engine has started, and until the kernel has run: compiled, and later.

    Without NumPy's own threads: these only wait here, and their waiting would count."""
    with tempfile.TemporaryDirectory(prefix="eldir-") as cache:
        changes = {f"{c}_OFFLINE_CACHE_FILE_PATH": cache for c in ("TI", "QD")} | {"ELDIR_THREADS": "1"}
        changes |= {"OPENBLAS_NUM_THREADS": "1"}
        return {name: _ask(_FIRST_USE, [], changes) for name in ("compiled", "cached")}


def _ask(code: str, arguments: list[str], changes: dict[str, str]) -> dict[str, float]:
    ran = subprocess.run(
        [sys.executable, "-c", code, *arguments], check=True, stdout=subprocess.PIPE, env=os.environ | changes
    )
    values: dict[str, float] = json.loads(ran.stdout)
    return values
