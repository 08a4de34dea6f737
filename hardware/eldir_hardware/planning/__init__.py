"""From a design's gait to a heating schedule for one rig, with the temperatures it leads to.

Gaits are searched in `eldir.built`; nothing is switched here.
"""
