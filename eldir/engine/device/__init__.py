"""The engine on graphics processors: a block of threads simulates a robot, a thread each cell of its grid.

The formulas are those of `eldir.engine.kernels`. What differs is who computes what, and where it lies.
"""
