"""Measurements of the engine for `eldir benchmark`: each module measures one thing.

`result.save` writes the numbers as JSON beside a plot. No other room uses this one, except the command.
"""
