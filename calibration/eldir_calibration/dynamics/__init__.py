"""A robot's parameters identified from films of it, with their uncertainty.

No files and no devices: recordings in, parameters out (`eldir_calibration.comparison` reads the logs).
"""
