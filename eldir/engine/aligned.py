"""Arrays whose memory is aligned for Taichi's vector views."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

ALIGNMENT = 128  # bytes: Taichi loads whole vectors and crashes on anything less aligned


def aligned(size: int, dtype: DTypeLike) -> NDArray[Any]:
    """Zeros, shape (size,), at an address that vectors can be loaded from."""
    kind = np.dtype(dtype)
    raw = np.zeros(size * kind.itemsize + ALIGNMENT, np.uint8)
    first = -raw.ctypes.data % ALIGNMENT
    return raw[first : first + size * kind.itemsize].view(kind)
