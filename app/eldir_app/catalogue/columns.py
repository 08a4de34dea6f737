"""Names of the columns that runs are sorted by. It imports nothing: the command's options need it."""

from typing import Literal

Column = Literal["recorded", "log", "rig", "design", "predicted", "filmed", "verdict", "seconds", "ended"]
