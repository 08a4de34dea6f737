"""Simulated, predicted and filmed motion compared, and the page that says so.

Motions come in as arrays; who predicted or filmed them is in `hardware.analysis`.
"""
