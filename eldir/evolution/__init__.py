"""Evolution of populations: search, the loop over generations, run folders, their analysis and figures.

How one robot learns is in `eldir.learning` and `eldir.training`. Each name in `__init__.pyi` is imported when
it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
