"""Side by side with programs that others, or we, wrote: equal work, checked results, interleaved turns.

Outside the package: nothing here is installed. `python -m benchmarks --out DIR` runs all that is at hand.
"""
