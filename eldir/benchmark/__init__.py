"""The engine measured: what `eldir benchmark` does. Each module measures one thing.

`result.save` writes the numbers as JSON beside a plot; nothing here is used by other rooms.
"""
