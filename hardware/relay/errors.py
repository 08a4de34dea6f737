"""Errors between the program and a relay's contact."""

from eldir.errors import EldirError, HazardError


class RelayError(EldirError):
    """The relay board cannot be trusted. Assume that the heat is on until it is proven off."""


class PortError(RelayError):
    """The port cannot be opened or has gone."""


class SilentBoardError(RelayError):
    """The board did not answer in time."""


class GarbledReplyError(RelayError):
    """The board's answer is not one of its protocol."""


class ContactError(RelayError, HazardError):
    """The board reports another state than the one commanded."""


class NotProvenOffError(RelayError, HazardError):
    """Contacts were commanded to open, and the board did not confirm it."""
