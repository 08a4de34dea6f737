"""Checks of a rig before it heats: port, board, camera, clock, disk.

Nothing here heats a spring.
"""
