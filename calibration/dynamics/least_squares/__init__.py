"""Identification as a least-squares problem: residuals, derivatives, and how sure the solution is.

Which models are tried, and whether one fits, is decided above (`candidates`, `verdict`).
"""
