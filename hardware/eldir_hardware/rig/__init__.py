"""The rig file: board, channels, supply, springs, camera; and which process holds the board's port.

Nothing is switched here.
"""
