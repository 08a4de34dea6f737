"""Sub-commands of `eldir` that need only the core."""
