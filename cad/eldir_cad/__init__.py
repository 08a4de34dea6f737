"""From a design to a packet that a workshop can print: kit, geometry, checks, shortlist, packet.

How a robot moves is computed in `eldir`; nothing here knows of a rig.
"""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())  # programs decide what is written
