"""The group `eldir calibrate`."""
