"""A word when a run has finished or stopped, a stop is latched, or the camera is lost.

A process of its own reads the log and sends it; nothing of this is in the way of heat.
"""
