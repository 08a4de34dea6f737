"""The sub-commands of `eldir`: a module each, or a room of modules for a group; found by their names.

They read options, call one function of a package below and print; decisions are there.
"""

ORDER = (
    "demo", "evolve", "status", "analyse", "shortlist", "show", "packet", "gait", "export", "transfer", "rig",
    "calibrate", "track", "report",
)  # fmt: skip
"""As a user meets them on the way from a population to a report; others follow by name."""
