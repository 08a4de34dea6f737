"""Reads logs and films into motions, predictions and recordings, runs identifications on them, and compares
predictions with MuJoCo.

The calibrations and comparisons themselves are in `calibration`; commands only parse options and print.
"""
