"""The live page of a run: a server that follows the log, and shows it to browsers.

The server only reads; it never opens a port of a board. Its stop is `eldir rig off` in a separate process.
"""
