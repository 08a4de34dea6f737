"""The printed robot: its bodies, heated springs, motion, gaits and the search for them.

Devices, schedules and limits of heat are in `hardware`. `build`, `drive` and `walk` are the public functions;
each is imported when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
