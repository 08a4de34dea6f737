"""Sub-commands of `eldir` for building.

They read options, call one function and print; decisions are below.
"""
