"""The rig as described by its file: board, channels, supply, springs, camera; and who holds its port.

Nothing is switched here.
"""
