"""The rig: relays, springs, cameras, logs, and the virtual rig that stands in for all of them.

What is about the robot rather than about a device is in `eldir.built`. Each name in `__init__.pyi` is
imported when it is first used.
"""

import logging

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
logging.getLogger(__name__).addHandler(logging.NullHandler())  # programs decide what is written
