"""The command `eldir`, and what stands on all other packages: demo, live page, catalogue of runs, doctor.

What a command does is decided in the packages below.
"""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())  # programs decide what is written
