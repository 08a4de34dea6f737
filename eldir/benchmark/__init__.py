"""Measurements of the engine for `eldir benchmark`: each module measures one thing.

`measurement.save` writes the numbers as JSON beside a plot.
"""
