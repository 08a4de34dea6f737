"""Parameters of a printed robot: strips and masses, springs, single parts, and the uncertainty of each.

Robots, motion and heat are computed in `eldir.built`.
"""
