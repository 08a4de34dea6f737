"""The catalogue of logs: what was recorded, how it ended, and what reports and people say about it.

The logs, the reports and the notes beside the logs are the source. The index is only a cache of what was read
from them, and can be rebuilt at any time.
"""

from __future__ import annotations

from typing import Literal

Column = Literal["recorded", "log", "rig", "design", "predicted", "filmed", "verdict", "seconds", "ended"]
