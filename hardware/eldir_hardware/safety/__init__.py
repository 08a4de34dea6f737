"""What must hold before heat is allowed, and what ends it: limits, stuck contacts, the latch, signals.

Limits while it is on are enforced by `eldir_hardware.guardian`.
"""
