"""From an evolved robot in simulation to the same robot walking on a table.

The names in `__init__.pyi` are the public interface (docs/reference/python.md); each is imported when it is
first used.
"""

import logging

import lazy_loader

from eldir.core.version import __version__ as __version__

logging.getLogger(__name__).addHandler(logging.NullHandler())  # programs decide what is written
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
