"""The simulation on all cores; the only place that knows Taichi. Nothing starts on import."""

import os
import warnings

from eldir.errors import MissingDependencyError

os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"  # it greets on import
try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import taichi  # noqa: F401
except ImportError as error:
    raise MissingDependencyError(
        "the engine needs taichi, which is not installed here",
        found=str(error),
        remedy="install it on x86-64 with Python 3.11 to 3.13; the rig works without it",
    ) from None
