"""The questions of the setup, in the order of docs/how-to/board-and-camera.md.

Each answer is checked with the whole rig file and written at once. Nothing here switches a contact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eldir.errors import InputError
from eldir.parameters.wiring import wiring
from eldir_app.rig_setup.devices import (
    LINKS,
    connected_ports,
    find_replugged,
    list_cameras,
    measure_picture,
    require_port,
)
from eldir_app.rig_setup.dialogue import (
    UNKNOWN,
    Dialogue,
    parse_choice,
    parse_measured,
    parse_number,
    parse_yes_no,
)
from eldir_app.rig_setup.draft import RigDraft
from eldir_hardware.relay.registration import get_board, installed_kinds
from eldir_hardware.rig.sections import LiveCameraEntry
from eldir_hardware.rig.template import MOTORS

FIND = "find"
"""Answer that lets the program find the port of the relay board by unplugging it."""
NONE = "none"
_INTERLOCKED, _NOT_INTERLOCKED = "interlocked", "not-interlocked"
_CUTOFFS = {
    "timer": ("max_on_s", "Longest time after which a timer opens its channel [s]"),
    "thermal": ("opens_at_c", "Highest temperature at which a switch opens [C]"),
    "contactor": ("channel", "Relay channel of the contactor"),
}


@dataclass(frozen=True)
class SetupConfig:
    """Answers that were given as options; None: the question is asked."""

    port: str | None = None
    board: str | None = None
    in_series: str | None = None
    channels: str | None = None
    contact_rating: str | None = None
    voltage: str | None = None
    outputs: str | None = None
    current_limit: str | None = None
    resistance: str | None = None
    room: str | None = None
    fan: str | None = None
    fan_channel: str | None = None
    cutoff: str | None = None
    cutoff_value: str | None = None
    camera: str | None = None
    tags: str | None = None

    @property
    def missing(self) -> list[str]:
        """Options that a setup without a terminal lacks."""
        unneeded = {
            name
            for answer, name in (
                (self.fan, "fan_channel"),
                (self.cutoff, "cutoff_value"),
                (self.camera, "tags"),
            )
            if answer in (None, NONE)
        }
        return [
            f"--{name.replace('_', '-')}"
            for name, answer in vars(self).items()
            if answer is None and name not in unneeded
        ]


@dataclass(frozen=True)
class Questions:
    """Asks what the rig file needs. Raises `typer.BadParameter` for options that are refused or missing."""

    draft: RigDraft
    config: SetupConfig
    dialogue: Dialogue
    links: Path = LINKS
    """Folder of the links of serial ports."""

    def ask_board(self) -> None:
        """Port and kind of the relay board, its wiring and its relays."""
        draft = self.draft
        board = draft.rig.board if draft.is_begun else None

        def accept_kind(kind: str) -> str:
            get_board(kind)
            if board is not None and kind != board.kind:
                # What was measured on a board of another kind does not hold for this one.
                draft.set_entries("board", {"kind": kind, "retriggerable": None})
            return kind

        def accept_wiring(answer: str) -> None:
            in_series = parse_yes_no(answer)
            if board is None:
                draft.begin(kind, port, in_series)
            elif in_series != (draft.rig.springs_per_channel > 1):
                draft.set_channels(wiring(max(MOTORS, draft.rig.motors), in_series=in_series))

        port = self._ask_port(None if board is None else board.port)
        kind = self.dialogue.ask(
            "--board",
            self.config.board,
            f"Kind of the relay board by its manual, never guessed: {', '.join(installed_kinds())}",
            accept_kind,
            None if board is None else board.kind,
        )
        self.dialogue.ask(
            "--in-series",
            self.config.in_series,
            "Are both springs of a motor in series on one channel? no: each spring has its own",
            accept_wiring,
            "yes" if board is not None and draft.rig.springs_per_channel > 1 else "no",
        )
        question = "Number of relays on the board"
        count = draft.rig.board.channels
        self._ask_entry("--channels", "board.channels", question, parse_number, self.config.channels, count)
        question = "Current that one of its contacts may carry, as printed on the relay [A]"
        given, rating = self.config.contact_rating, draft.rig.board.contact_rating_a
        self._ask_entry("--contact-rating", "board.contact_rating_a", question, parse_number, given, rating)

    def _ask_port(self, known: str | None) -> str:
        ports = sorted(connected_ports(self.links))
        if self.config.port is None and self.dialogue.is_interactive:
            self.dialogue.say("Serial ports:" if ports else "No serial port is connected.")
            for number, name in enumerate(ports, start=1):
                self.dialogue.say(f"  {number}  {name}")

        def accept(answer: str) -> str:
            if answer == FIND:
                answer = find_replugged(self.dialogue, self.links)
            elif answer.isdecimal():
                parse_choice(answer, tuple(str(n) for n in range(1, 1 + len(ports))))
                answer = ports[int(answer) - 1]
            require_port(answer)
            if self.draft.is_begun:
                self.draft.set_entries("board", {"port": answer})
            return answer

        question = f"Port of the relay board: a number, a path, or {FIND} (by unplugging the board)"
        port = self.dialogue.ask("--port", self.config.port, question, accept, known or FIND)
        self.dialogue.say(f"The relay board is at {port}")
        return port

    def ask_values(self) -> None:
        """Supply, springs, fan and cut-off."""
        config, supply, springs = self.config, self.draft.rig.supply, self.draft.rig.springs
        ask = self._ask_entry
        question = "Voltage of the heating supply [V]"
        ask("--voltage", "supply.voltage_v", question, parse_number, config.voltage, supply.voltage_v)
        question = "Is the current limited for each channel (each), or for all together (shared)?"
        ask("--outputs", "supply.outputs", question, _parse_outputs, config.outputs, supply.outputs)
        question = f"Current limit of an output [A], or {UNKNOWN}"
        known, given = supply.current_limit_a, config.current_limit
        ask("--current-limit", "supply.current_limit_a", question, parse_measured, given, known)
        question = f"Measured resistance of one spring at room temperature [Ohm], or {UNKNOWN}"
        cold, given = springs.resistance_ohm, config.resistance
        ask("--resistance", "springs.resistance_ohm", question, parse_measured, given, cold)
        question = "Temperature of the air around the springs [C]"
        ask("--room", "springs.ambient_c", question, self._parse_room, config.room, springs.ambient_c)
        self._ask_fan()
        self._ask_cutoff()

    def _parse_room(self, answer: str) -> float:
        room, allowed = parse_number(answer), self.draft.rig.tolerances
        if not allowed.ambient_min_c <= room <= allowed.ambient_max_c:
            raise InputError(
                "the air is outside of the tolerances for which limits are checked",
                expected=f"{allowed.ambient_min_c:g} to {allowed.ambient_max_c:g} C",
                found=f"{room:g} C",
                remedy=f"change tolerances in {self.draft.path}, then run this command again",
            )
        return room

    def _ask_fan(self) -> None:
        fan = self.draft.rig.fan
        names = {None: NONE, True: _INTERLOCKED, False: _NOT_INTERLOCKED}
        kind = self.dialogue.ask(
            "--fan",
            self.config.fan,
            f"Fan: {_INTERLOCKED} (hardware cuts the heating supply when the fan stops), {_NOT_INTERLOCKED}, "
            f"or {NONE}",
            lambda answer: parse_choice(answer, (_INTERLOCKED, _NOT_INTERLOCKED, NONE)),
            names[None if fan is None else fan.interlocked],
        )
        if kind == NONE:
            self._remove("fan")
            return

        def accept(answer: str) -> None:
            channel = {} if answer == NONE else {"channel": parse_number(answer)}
            self.draft.set_section("fan", {"interlocked": kind == _INTERLOCKED, **channel})

        known = NONE if fan is None or fan.channel is None else str(fan.channel)
        question = f"Relay channel that runs the fan, or {NONE}"
        self.dialogue.ask("--fan-channel", self.config.fan_channel, question, accept, known)

    def _ask_cutoff(self) -> None:
        cutoff = self.draft.rig.cutoff
        kind = self.dialogue.ask(
            "--cutoff",
            self.config.cutoff,
            "Independent cut-off, which opens when a contact welds: timer (at each channel), thermal (a "
            f"switch on each spring), contactor, or {NONE}",
            lambda answer: parse_choice(answer, (*_CUTOFFS, NONE)),
            NONE if cutoff is None else cutoff.kind,
        )
        if kind == NONE:
            self._remove("cutoff")
            return
        entry, question = _CUTOFFS[kind]
        known = None if cutoff is None or cutoff.kind != kind else _describe(getattr(cutoff, entry))

        def accept(answer: str) -> None:
            self.draft.set_section("cutoff", {"kind": kind, entry: parse_number(answer)})

        self.dialogue.ask("--cutoff-value", self.config.cutoff_value, question, accept, known)

    def ask_camera(self) -> None:
        """The camera and the file with the places of its reference tags."""
        known = self.draft.rig.camera
        assert known is None or isinstance(known, LiveCameraEntry)  # a real rig has no other
        default = NONE if known is None else known.device
        if self.config.camera is None and self.dialogue.is_interactive:
            self.dialogue.say("Looking for cameras ...")
            for name, (width, height) in list_cameras().items():
                self.dialogue.say(f"  {name} gives pictures of {width}x{height}")
                default = name if default == NONE else default
        camera = self.dialogue.ask(
            "--camera",
            self.config.camera,
            f"Camera: camera:0, /dev/video0, the address of a stream, or {NONE}",
            lambda answer: None if answer == NONE else (answer, measure_picture(answer)),
            default,
        )
        if camera is None:
            self._remove("camera")
            return
        device, (width, height) = camera
        entry: dict[str, Any] = {"kind": "live", "device": device, "width": width, "height": height}
        if known is not None and (known.device, known.width, known.height) == (device, width, height):
            kept = {"rate_hz": known.rate_hz, "lens": known.lens, "plane": known.plane}
            entry |= {name: value for name, value in kept.items() if value is not None}

        def accept(answer: str) -> None:
            from eldir_hardware.camera.plane import TagBoard

            TagBoard.load(self.draft.path.parent / answer)
            self.draft.set_section("camera", {**entry, "tags": answer})

        question = "File with the places of the reference tags (eldir-tags/1), beside the rig file"
        tags = known.tags if known is not None and known.tags else "tags.json"
        self.dialogue.ask("--tags", self.config.tags, question, accept, tags)

    def _remove(self, section: str) -> None:
        """Write that the rig has no such thing."""
        if getattr(self.draft.rig, section) is not None:
            self.draft.set_section(section, None)

    def _ask_entry(
        self,
        option: str,
        entry: str,
        question: str,
        parse: Callable[[str], Any],
        given: str | None,
        known: float | str | None,
    ) -> None:
        """Ask for an entry of the rig file, such as supply.voltage_v."""
        section, _, name = entry.partition(".")

        def accept(answer: str) -> Any:
            value = parse(answer)
            self.draft.set_entries(section, {name: value})
            return value

        default = UNKNOWN if known is None else _describe(known)
        if self.dialogue.ask(option, given, question, accept, default) is None:
            self.dialogue.say(f"{entry} stays null: without it the rig will not arm.")


def _describe(value: float | str) -> str:
    """A value as a person types it; no digit is lost."""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def _parse_outputs(answer: str) -> str:
    return parse_choice(answer, ("each", "shared"))
