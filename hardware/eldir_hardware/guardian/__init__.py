"""The process that alone owns a relay board's port, and lets it heat only while its client is alive.

Schedules are played in `eldir_hardware.run`; limits before a run are checked in `eldir_hardware.safety`.
"""
