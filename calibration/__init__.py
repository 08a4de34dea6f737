"""Arrays in, parameters out: camera, springs, dynamics, and the report that compares motions.

No devices and no logs (`hardware`).
"""
