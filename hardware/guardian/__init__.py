"""The process that alone owns a relay board's port, and lets it heat only while its client is alive.

Schedules are played in `hardware.run`; limits before a run are checked in `hardware.safety`.
"""
