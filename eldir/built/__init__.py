"""The printed robot: its bodies, heated springs, motion, gaits and the search for them.

Devices, schedules and limits of heat are in `hardware`.
"""
