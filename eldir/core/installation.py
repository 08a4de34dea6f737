"""What is installed here and on what machine, from metadata and files alone: nothing heavy is imported."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, distribution, entry_points, version
from pathlib import Path
from typing import Any

from eldir.core.kernels import COMPILERS, compiler_name
from eldir.core.version import __version__, source_digest
from eldir.errors import EldirError

FORMAT = "eldir-info/1"
_DEVELOPERS = ("test", "docs")
"""Extras that add nothing for users."""
_VECTORS = ("sse4_2", "avx", "fma", "avx2", "avx512f", "asimd", "sve")
"""CPU flags that decide how wide the engine's vectors are."""
_VARIABLES = ("ELDIR_COMPILER", "ELDIR_THREADS", "RAY_ADDRESS", "ROS_DISTRO", "VIRTUAL_ENV")
_DEVICES = {"ports": ("serial/by-id/*", "ttyUSB*", "ttyACM*"), "cameras": ("v4l/by-id/*", "video*")}


def describe() -> dict[str, Any]:
    """The installation as `eldir info --json` prints it (docs/schemas/info.schema.json)."""
    libraries, extras = requirements()
    return {
        "format": FORMAT,
        "eldir": {
            "version": __version__,
            "source": _or_problem(source_digest),
            "folder": str(Path(__file__).parents[1]),
        },
        "python": {"version": platform.python_version(), "implementation": platform.python_implementation()},
        "platform": {"system": platform.platform(), "machine": platform.machine(), **processor()},
        "compiler": {
            "chosen": _or_problem(compiler_name),
            "installed": {name: found for name in COMPILERS if (found := installed(name))},
        },
        "libraries": {name: installed(name) for name in libraries},
        "extras": {extra: {n: installed(n) for n in names} for extra, names in extras.items()},
        "plug-ins": sorted(_plug_ins()),
        "variables": {name: os.environ[name] for name in _VARIABLES if name in os.environ},
        **{kind: sorted(_devices(patterns)) for kind, patterns in _DEVICES.items()},
    }


def installed(name: str) -> str | None:
    """Version of a distribution; None where it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def requirements() -> tuple[list[str], dict[str, list[str]]]:
    """Distributions that eldir requires, and those of each extra. The engine's compilers, of which one is
    enough, count only as an extra."""
    always: list[str] = []
    extras: dict[str, list[str]] = {}
    for line in distribution("eldir").requires or []:
        name = re.split(r"[\s<>=!~;\[(]", line, maxsplit=1)[0]
        asked = re.search(r"""extra == ["']([\w-]+)""", line)
        if asked is None:
            if name not in COMPILERS:
                always.append(name)
        elif asked[1] not in _DEVELOPERS:
            extras.setdefault(asked[1], []).append(name)
    return always, extras


def _or_problem(ask: Callable[[], str]) -> str:
    try:
        return ask()
    except EldirError as error:
        return f"none: {error}"


def processor() -> dict[str, Any]:
    """Name of the processor, cores that this process may use, vector instructions, memory [GB]."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        text = ""
    name = re.search(r"^(?:model name|Model)\s*:\s*(.+)", text, re.MULTILINE)
    flags = re.search(r"^(?:flags|Features)\s*:\s*(.+)", text, re.MULTILINE)
    words = flags[1].split() if flags else []
    return {
        "processor": name[1] if name else platform.processor(),
        "cores": len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count(),
        "vectors": [flag for flag in _VECTORS if flag in words],
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
    }


def _plug_ins() -> Iterator[str]:
    """Commands, boards, kinds of marker and problems that other distributions add."""
    for group in ("eldir.commands", "eldir.boards", "eldir.markers", "eldir.problems"):
        for point in entry_points(group=group):
            if point.dist is not None and point.dist.name != "eldir":
                yield f"{group}: {point.name} of {point.dist.name} {point.dist.version}"


def _devices(patterns: tuple[str, ...]) -> Iterator[str]:
    """Names below /dev; none is opened."""
    for pattern in patterns:
        yield from map(str, Path("/dev").glob(pattern))
