"""Comparison of simulated, predicted and filmed motion, and the page that shows it.

Motions come in as arrays; who predicted or filmed them is in `eldir_calibration.comparison`.
"""
