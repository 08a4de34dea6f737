"""The compiler of all kernels, loaded without its greeting. Every kernel imports `ti` from here."""

from __future__ import annotations

import os
import warnings

from eldir.errors import MissingDependencyError

os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"  # it prints its version when imported
try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import taichi as ti
except ImportError as error:
    raise MissingDependencyError(
        "the engine needs taichi, which is not installed here",
        found=str(error),
        remedy="install it on x86-64 with Python 3.11 to 3.13; the rig works without it",
    ) from None

__all__ = ["ti"]
