"""Parameters of camera, springs and dynamics from arrays, and the report that compares motions.

Devices and logs are in `hardware`.
"""
