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
    installation = describe()
    print(json.dumps(installation, indent=1) if as_json else "\n".join(_lines(installation)))


def version_lines() -> str:
    """Version of eldir; on the second line those of Python, the engine's compiler and the main libraries."""
    versions = ((name, installed(name)) for name in (*COMPILERS, *_LIBRARIES))
    parts = [f"Python {platform.python_version()}", *(f"{n} {v}" for n, v in versions if v)]
    return f"eldir {__version__}\n{', '.join(parts)}"


def _lines(installation: dict[str, Any]) -> Iterator[str]:
    own, machine = installation["eldir"], installation["platform"]
    compiler = installation["compiler"]
    yield f"eldir      {own['version']}, source {own['source']}, in {own['folder']}"
    yield f"Python     {installation['python']['version']}, {installation['python']['implementation']}"
    yield f"platform   {machine['system']}"
    vectors = ", ".join(machine["vectors"]) or "unknown"
    yield f"processor  {machine['processor']}, {machine['cores']} cores, vectors {vectors}"
    yield f"memory     {machine['memory_gb']} GB"
    yield f"compiler   {compiler['chosen']}; installed: {_versions(compiler['installed'])}"
    yield f"libraries  {_versions(installation['libraries'])}"
    for name, libraries in installation["extras"].items():
        missing = [n for n, v in libraries.items() if v is None]
        remedy = f"not installed: pip install 'eldir[{name}]'" if missing else _versions(libraries)
        yield f"extra      {name}: {remedy}"
    for kind in ("plug-ins", "ports", "cameras"):
        yield f"{kind:10} {', '.join(installation[kind]) or 'none'}"
    yield f"variables  {', '.join(f'{n}={v}' for n, v in installation['variables'].items()) or 'none'}"


def _versions(libraries: Mapping[str, str | None]) -> str:
    return ", ".join(f"{name} {version or 'MISSING'}" for name, version in libraries.items()) or "none"
