"""Identification as a least-squares problem: residuals, derivatives, and the uncertainty of the solution.

Which models are tried, and whether one fits, is decided above (`candidates`, `verdict`).
"""
