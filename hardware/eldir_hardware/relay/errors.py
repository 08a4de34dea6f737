"""Errors between the program and a relay's contact."""

from eldir.errors import EldirError, HazardError


class RelayError(EldirError):
    """The state of the relay board is unknown. Assume that the heat is on until it is proven off."""

    code = "board"


class PortError(RelayError):
    """The port cannot be opened or was lost."""

    code = "board.port"


class BlockedPortError(PortError):
    """The port accepts no bytes, or does not transmit them."""

    code = "board.port-blocked"


class SilentBoardError(RelayError):
    """The board did not answer in time."""

    code = "board.silent"


class GarbledReplyError(RelayError):
    """The board's answer is not one of its protocol."""

    code = "board.garbled-reply"


class TooManyRelaysError(GarbledReplyError, HazardError):
    """The board has more relays than any board of its kind: `all_off` would not open the others."""

    code = "board.too-many-relays"

    def __init__(self, max_relays: int, found: str):
        super().__init__(
            "the relay board has more relays than its kind",
            expected=f"at most {max_relays}",
            found=found,
            remedy="cut the heating supply now, then check the board's kind in the rig file",
        )


class ContactError(RelayError, HazardError):
    """The board reports another state than the one commanded."""

    code = "board.contact"


class NotProvenOffError(RelayError, HazardError):
    """Contacts were commanded to open, and the board did not confirm it."""

    code = "board.not-proven-off"
