"""What the kernels know of the processor they are compiled for."""

import platform
from functools import cache
from pathlib import Path

_FLAGS = Path("/proc/cpuinfo")


@cache
def has_wide_registers() -> bool:
    """Whether there are 32 registers of 512 bits (AVX-512).

    Sums over the 32 hidden units are then computed four or eight at a time, so that each value is loaded
    once for all of them. AVX2 has 16 registers of 256 bits, of which one such sum takes four in float32 and
    eight in float64. Of several sums, some would be stored and loaded again at every step.
    """
    if platform.machine() != "x86_64":  # an emulated processor may show the flags of its host
        return False
    try:
        return "avx512f" in _FLAGS.read_text().split()
    except OSError:
        return False
