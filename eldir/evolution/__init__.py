"""Populations: search, the loop over generations, run folders, their analysis and figures.

How one robot learns is in `eldir.learning` and `eldir.training`.
"""
