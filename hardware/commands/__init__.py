"""Sub-commands of `eldir` about the rig, its schedules, logs and reports.

They read options, call one function and print; decisions are below.
"""
