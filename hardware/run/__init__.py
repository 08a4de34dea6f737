"""A schedule played, filmed and recorded.

Switching itself is behind `hardware.guardian`; results are computed in `hardware.analysis`.
"""
