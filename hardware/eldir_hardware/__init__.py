"""The rig: relays, springs, cameras, logs, and the virtual rig that stands in for all of them.

What is about the robot rather than about a device is in `eldir.built`.
"""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())  # programs decide what is written
