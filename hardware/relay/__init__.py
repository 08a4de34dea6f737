"""Relay boards: one interface, one driver for each byte protocol."""
