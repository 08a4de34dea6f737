"""Sub-commands of `eldir` for building robots.

They read options, call one function and print; decisions are below.
"""
