"""Default values of the evolution of printed robots. It imports nothing heavy: the command reads them too."""

from __future__ import annotations

LATTICE = (6, 11)
"""Rows and columns that a printer's workspace holds."""
OFFSPRING = 32
GENERATIONS = 12
MOTORS = 2
"""Four channels heat two motors, each with a spring on both faces."""
MARGIN = 0.02
"""Required static margin [m]."""
TIMINGS = ((20.0, 6.0), (18.6, 6.0), (23.0, 6.0))
"""Periods and times of heating [s] that the rig of the template allows (tests hold them against it)."""
