"""The command `eldir`, and what uses all other packages: demo, live page, catalogue of runs, doctor.

Decisions are made in the packages below.
"""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())  # programs choose the handlers
