"""Sub-commands of `eldir` that need this package only.

They read options, call one function and print; decisions are below.
"""
