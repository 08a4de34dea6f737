"""The command `eldir info`, and what `eldir --version` prints."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from eldir.core.installation import describe, installed
from eldir.core.kernels import COMPILERS
from eldir.core.version import __version__

_LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "trimesh", "mujoco-core")


def info(
    as_json: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
) -> None:
    """Print versions, machine, extras and devices, for a bug report. No device is opened.

    Example: eldir info > info.txt
    """
    found = describe()
    print(json.dumps(found, indent=1) if as_json else "\n".join(_lines(found)))


def version_lines() -> str:
    """Version of eldir; below it those of the engine's compiler and of the key libraries."""
    known = ((name, installed(name)) for name in (*COMPILERS, *_LIBRARIES))
    named = [f"Python {platform.python_version()}", *(f"{n} {v}" for n, v in known if v)]
    return f"eldir {__version__}\n{', '.join(named)}"


def _lines(found: dict[str, Any]) -> Iterator[str]:
    own, machine, compiler = found["eldir"], found["platform"], found["compiler"]
    yield f"eldir      {own['version']}, source {own['source']}, in {own['folder']}"
    yield f"Python     {found['python']['version']}, {found['python']['implementation']}"
    yield f"platform   {machine['system']}"
    vectors = ", ".join(machine["vectors"]) or "unknown"
    yield f"processor  {machine['processor']}, {machine['cores']} cores, vectors {vectors}"
    yield f"memory     {machine['memory_gb']} GB"
    yield f"compiler   {compiler['chosen']}; installed: {_versions(compiler['installed'])}"
    yield f"libraries  {_versions(found['libraries'])}"
    for name, libraries in found["extras"].items():
        missing = [n for n, v in libraries.items() if v is None]
        remedy = f"not installed: pip install 'eldir[{name}]'" if missing else _versions(libraries)
        yield f"extra      {name}: {remedy}"
    for kind in ("plug-ins", "ports", "cameras"):
        yield f"{kind:10} {', '.join(found[kind]) or 'none'}"
    yield f"variables  {', '.join(f'{n}={v}' for n, v in found['variables'].items()) or 'none'}"


def _versions(libraries: Mapping[str, str | None]) -> str:
    return ", ".join(f"{name} {version or 'MISSING'}" for name, version in libraries.items()) or "none"
