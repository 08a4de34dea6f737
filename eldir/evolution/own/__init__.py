"""Evolution of a researcher's own problem: one class, in a package of its own, found by its entry point."""
