"""The sub-commands of `eldir calibrate`: camera, plane, springs, dynamics.

They read options, call one function of `calibration` or `hardware` and print.
"""
