"""Sub-commands of `eldir` for building."""
