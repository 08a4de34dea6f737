"""Which spring grew warm, as a person feels it, and the wiring that follows."""

from __future__ import annotations

import re

from eldir.errors import EldirError, InputError
from eldir.parameters.wiring import Connection, HeatedFaces, Wiring
from eldir_app.rig_setup.dialogue import Dialogue
from eldir_hardware.rig.configuration import Rig

_SPRING = re.compile(r"(?P<number>\d{1,2})( (?P<face>front|back))?")


class FeltSprings:
    """Asks after each pulse which spring grew warm, without waiting for the answer."""

    def __init__(self, rig: Rig, dialogue: Dialogue):
        self._rig, self._dialogue = rig, dialogue
        self._current: Connection | None = None
        self.felt: dict[int, Connection | None] = {}
        """The spring that each channel warmed, by channel; None where none grew warm."""

    def is_answered(self, connection: Connection) -> bool:
        """Whether the question for this channel was answered. What was typed before it does not count."""
        if self._current != connection:
            self._dialogue.discard()
            self._current = connection
            self._show_question()
        answer = self._dialogue.poll_line()
        if answer is None:
            return False
        try:
            self.felt[connection.channel] = self._parse(answer, connection)
        except EldirError as error:
            self._dialogue.say(str(error))
            self._show_question()
            return False
        return True

    def _show_question(self) -> None:
        assert self._current is not None
        example = "1" if self._current.face == "both" else "1 back"
        self._dialogue.say(
            f"Did {self._current.spring_text} grow warm? y, n (none did), or the one that did, such as "
            f"{example}: ",
            newline=False,
        )

    def _parse(self, answer: str, connection: Connection) -> Connection | None:
        answer = answer.lower()
        if answer in ("y", "yes"):
            return connection
        if answer in ("n", "no"):
            return None
        match = _SPRING.fullmatch(answer)
        face: HeatedFaces | None = "both" if connection.face == "both" else None
        if match is not None and match["face"] is not None and face is None:
            face = "front" if match["face"] == "front" else "back"
        if match is None or face is None or (face == "both") != (match["face"] is None):
            raise InputError("invalid answer", expected="y, n or a spring", found=repr(answer))
        if int(match["number"]) >= self._rig.motors:
            raise InputError(
                "there is no such spring in the rig file",
                expected=f"a number from 0 to {self._rig.motors - 1}",
                found=match["number"],
            )
        return Connection(connection.channel, int(match["number"]), face)

    def find_wiring(self) -> Wiring:
        """The wiring that was felt; channels that were not warmed are as in the rig file.

        Raises `InputError` unless every channel warmed one spring, each another one.
        """
        cold = [channel for channel, spring in self.felt.items() if spring is None]
        if cold:
            raise InputError(
                f"no spring of channels {', '.join(map(str, cold))} grew warm",
                remedy="check the wires and the supply, then run: eldir rig doctor --wiring",
            )
        connections = [self.felt.get(c.channel) or c for c in self._rig.channels]
        by_spring: dict[str, list[int]] = {}
        for c in connections:
            by_spring.setdefault(c.spring_text, []).append(c.channel)
        for spring, channels in by_spring.items():
            if len(channels) > 1:
                raise InputError(
                    f"{spring} grew warm at channels {', '.join(map(str, channels))}",
                    expected="another spring at each channel",
                    remedy="check the wires, then run: eldir rig doctor --wiring",
                )
        return tuple(sorted(connections))
