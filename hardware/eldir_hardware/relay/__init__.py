"""Relay boards: one interface, and one driver for each byte protocol.

When a contact may close is decided in `eldir_hardware.guardian`, not here.
"""
