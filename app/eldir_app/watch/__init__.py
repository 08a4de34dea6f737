"""The live page of a run: a server that follows the log, and shows it to browsers.

It reads; it never opens a port and starts no heat. Its Stop is `eldir rig off` in a process of its own.
"""
