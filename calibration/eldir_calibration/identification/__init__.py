"""Identification from logs and tables: reads them, runs the fit, writes what was found into the rig file.

The fits themselves, from arrays, are in `eldir_calibration.dynamics` and `springs`.
"""
