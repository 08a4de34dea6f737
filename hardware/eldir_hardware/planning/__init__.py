"""From a design's gait to a heating schedule for one rig, with its predicted temperatures.

Gaits are searched in `eldir.built`; nothing is switched here.
"""
