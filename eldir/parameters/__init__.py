"""A printed robot in numbers: strips and masses, springs, single parts, and how uncertain each number is.

Nothing is computed from them here: robots, motion and heat are in `eldir.built`.
"""
