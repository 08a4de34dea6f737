"""Sub-commands of `eldir` about the rig, its schedules, logs and reports."""
