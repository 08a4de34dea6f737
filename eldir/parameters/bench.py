"""Ratings of the bench that heats a printed robot, for a new rig file and for the packet's kit.

The current limit of an output is `coil.current_limit_a` of the parts; voltage, resistance and leads are those
of `eldir.parameters.springs`.
"""

from __future__ import annotations

CONTACT_RATING_A = 10.0
"""Current that one relay contact may carry [A]."""
MAX_TOTAL_CURRENT_A = 16.0
"""Largest current of all outputs of the supply together [A]."""
MAX_ON_S = 6.0
"""Longest time for which a channel may be closed [s]."""
TIMER_S = 6.3
"""Longest time after which the timer relay of a channel opens, its tolerance included [s]."""
RESISTANCE_TOLERANCE = 0.05
"""Relative tolerance of the resistance of a spring, around the value in the rig file."""
