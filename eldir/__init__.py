"""From an evolved robot in simulation to the same robot walking on a table."""

__version__ = "0.1.0"
