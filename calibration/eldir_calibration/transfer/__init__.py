"""Comparison of predicted walks of designs with their walks in MuJoCo, and its page.

A film of a robot is compared in `eldir_calibration.report`.
"""
