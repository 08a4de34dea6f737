"""Parameters of camera, springs and dynamics from arrays, and the report that compares motions.

Devices and logs are in `hardware`.
"""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())  # programs decide what is written
