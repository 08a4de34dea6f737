"""Predicted walks of designs beside their walks in MuJoCo, and the page that tells how far they agree.

A film of a robot is compared in `eldir_calibration.report`.
"""
