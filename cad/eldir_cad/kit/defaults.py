"""Default values of the kit. It imports nothing heavy: the commands can read them too."""

from __future__ import annotations

PRINTER = "xip"
"""Name of the printer profile."""
TOP = 6
"""Number of designs on a shortlist."""
SEED = 0
"""Seed of the samples with which a shortlist is ranked."""
