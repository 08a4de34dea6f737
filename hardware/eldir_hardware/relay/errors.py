"""Errors between the program and a relay's contact."""

from eldir.errors import EldirError, HazardError


class RelayError(EldirError):
    """The relay board cannot be trusted. Assume that the heat is on until it is proven off."""

    code = "board"


class PortError(RelayError):
    """The port cannot be opened or has gone."""

    code = "board.port"


class BlockedPortError(PortError):
    """The port does not take the bytes, or does not send them."""

    code = "board.port-blocked"


class SilentBoardError(RelayError):
    """The board did not answer in time."""

    code = "board.silent"


class GarbledReplyError(RelayError):
    """The board's answer is not one of its protocol."""

    code = "board.garbled-reply"


class TooManyRelaysError(GarbledReplyError, HazardError):
    """The board answers for more relays than any board of its kind has: those would stay as they are."""

    code = "board.too-many-relays"

    def __init__(self, most: int, found: str):
        super().__init__(
            "the relay board has more relays than its kind",
            expected=f"at most {most}",
            found=found,
            remedy="cut the heating supply now, then check the board's kind in the rig file",
        )


class ContactError(RelayError, HazardError):
    """The board reports another state than the one commanded."""

    code = "board.contact"


class NotProvenOffError(RelayError, HazardError):
    """Contacts were commanded to open, and the board did not confirm it."""

    code = "board.not-proven-off"
