"""Emulated relay boards on pseudo-terminals, written from the manuals.

They share no code with the drivers in `eldir_hardware.relay`.
"""
