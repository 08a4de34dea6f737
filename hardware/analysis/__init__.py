"""Reads logs and films into motions, predictions and recordings, and runs identifications on them.

The calibrations and comparisons themselves are in `calibration`; commands only parse options and print.
"""
