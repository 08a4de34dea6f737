"""From logs to motions, predictions and what an identification takes.

Comparison and identification themselves are in `calibration`.
"""
