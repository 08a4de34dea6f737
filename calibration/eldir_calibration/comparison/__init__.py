"""From a log and a film to motions, and the predictions that they are compared with.

The report of a comparison is written by `eldir_calibration.report`.
"""
