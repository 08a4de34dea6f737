"""Evolution of a researcher's own problem: one class, in a package of its own, found by its entry point.

Problems of robots that come with eldir are in `eldir.evolution.paper` and `eldir.evolution.printed`.
"""
