"""What may be chosen about the engine's kernels: their numbers, the compiler, and the device that learns.
Nothing heavy is imported.

The compiler is Taichi where it is installed. Its maintained successor Quadrants where it is not, or where
`ELDIR_COMPILER=quadrants` asks for it. Both round differently, so it belongs to the digest of the code.
"""

from __future__ import annotations

import os
from importlib.util import find_spec
from typing import Literal, cast, get_args

from eldir.core.arguments import require_value
from eldir.errors import MissingDependencyError

Precision = Literal["f32", "f64"]
PRECISION: Precision = "f32"
COMPILERS = ("taichi", "quadrants")
"""By preference."""
Device = Literal["cpu", "cuda", "vulkan"]
DeviceChoice = Literal["cpu", "cuda", "vulkan", "auto"]


def compiler_name() -> str:
    """taichi | quadrants: the one that `ELDIR_COMPILER` asks for, else the first that is installed.

    Nothing is imported. Raises `InputError` for another name, `MissingDependencyError` where it is not
    installed."""
    asked = os.environ.get("ELDIR_COMPILER", "")
    require_value("ELDIR_COMPILER", asked in ("", *COMPILERS), " or ".join(COMPILERS), repr(asked))
    there = [name for name in COMPILERS if find_spec(name) is not None]
    if asked and asked not in there:
        raise MissingDependencyError(
            f"ELDIR_COMPILER asks for {asked}, which is not installed here", remedy=f"pip install {asked}"
        )
    if not there:
        raise MissingDependencyError(
            "the engine needs taichi or quadrants, and neither is installed here",
            remedy="pip install 'eldir[quadrants]'; the rig works without them",
        )
    return asked or there[0]


def device_name() -> DeviceChoice:
    """cpu | cuda | vulkan | auto: where robots learn, by `ELDIR_DEVICE`; cpu where it is not set.

    Raises `InputError` for another name."""
    asked = os.environ.get("ELDIR_DEVICE", "") or "cpu"
    known = get_args(DeviceChoice)
    require_value("ELDIR_DEVICE", asked in known, ", ".join(known), repr(asked))
    return cast(DeviceChoice, asked)
