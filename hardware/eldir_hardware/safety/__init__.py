"""Checks before heating, and the emergency stop: limits, welded contacts, the latch, signals.

Limits while it is on are enforced by `eldir_hardware.guardian`.
"""
