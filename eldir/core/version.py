"""Version of the program, and the digest of its source, which files that it writes hold."""

from __future__ import annotations

import hashlib
import logging
from functools import cache
from pathlib import Path

from eldir.core.kernels import compiler_name

__version__ = "0.1.0"


_logger = logging.getLogger(__name__)


@cache
def source_digest() -> str:
    """Digest of all source files of the package `eldir` and of the name of the kernels' compiler, 12
    hexadecimal digits: equal digests, equal results on one machine."""
    here = Path(__file__).parents[1]
    digest = hashlib.sha256(compiler_name().encode())
    for path in sorted(here.rglob("*.py")):
        digest.update(path.relative_to(here).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def warn_of_other_source(path: Path, source: str) -> None:
    """Log a warning where a run was started by code with another digest than this."""
    if source != source_digest():
        _logger.warning(
            f"{path} was started by another version of the code ({source}, this is {source_digest()}): "
            "the result may not have the same bytes"
        )
