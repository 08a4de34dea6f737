"""`eldir rig setup`: dialogue at a terminal, answers as options, boards found by unplugging, wiring felt."""

import os
import pty
import re
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
import pytest

from eldir.errors import InputError
from eldir.parameters.wiring import Connection
from eldir_app.rig_setup.dialogue import Dialogue
from eldir_app.rig_setup.felt_springs import FeltSprings
from eldir_app.switching_checks import PAUSE_S, warm_each, warming_pulse
from eldir_hardware.camera.plane import TagBoard
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.virtual.rig import VirtualRig
from tests.forked_programs import Forked
from tests.hardware.emulated_rigs import emulated, run
from tests.hardware.rigs_and_schedules import RIG
from tests.hardware.virtual.piston_and_observer import Piston

ANSWERS = {
    "--board": "lcus",
    "--channels": "8",
    "--contact-rating": "10",
    "--voltage": "11,5",
    "--outputs": "each",
    "--current-limit": "3.4",
    "--resistance": "0.99",
    "--room": "21",
    "--fan": "interlocked",
    "--fan-channel": "none",
    "--cutoff": "timer",
    "--cutoff-value": "6.3",
    "--camera": "none",
}


class Person:
    """Types answers at the terminal of a program, after what the program asks."""

    def __init__(self, host: int):
        self._host = host
        self._new = ""
        self.seen = ""
        """All that the program wrote."""

    def answer(self, question: str, line: str) -> None:
        """Wait for these words, then type a line."""
        self.wait_for(question)
        os.write(self._host, f"{line}\n".encode())

    def type_ahead(self, line: str) -> None:
        """Type a line that nothing asks for."""
        os.write(self._host, f"{line}\n".encode())

    def wait_for(self, question: str, seconds: float = 30.0) -> None:
        """Wait for these words."""
        deadline = time.monotonic() + seconds
        while question not in self._new:
            assert select.select([self._host], [], [], max(0.0, deadline - time.monotonic()))[0], self.seen
            text = os.read(self._host, 4096).decode()
            self._new, self.seen = self._new + text, self.seen + text
        self._new = self._new.partition(question)[2]

    def read_rest(self) -> str:
        """All that the program wrote, now that it has ended."""
        while select.select([self._host], [], [], 0)[0]:
            self.seen += os.read(self._host, 4096).decode()
        return self.seen


@contextmanager
def at_a_terminal(*words: object) -> Iterator[tuple[Forked, Person]]:
    """A program whose streams are a terminal."""
    host, guest = pty.openpty()
    with Forked([sys.executable, *map(str, words)], stdin=guest, stdout=guest, stderr=guest) as program:
        try:
            yield program, Person(host)
        finally:
            program.kill()
            os.close(host)
            os.close(guest)


def options(**changes: str | None) -> list[str]:
    """All answers as options, without those that are None."""
    given = ANSWERS | {f"--{name.replace('_', '-')}": value for name, value in changes.items()}
    return [
        "--no-in-series",
        *(w for name, value in given.items() if value is not None for w in (name, value)),
    ]


def test_a_student_sets_up_a_rig_whose_springs_are_swapped(tmp_path):
    """In series: channel 1 heats the springs that the rig file takes for those of channel 2."""
    path = tmp_path / "rig.yaml"
    setup = ("-m", "eldir", "rig", "setup", "--out", path)
    with emulated("lcus") as board, at_a_terminal(*setup) as (program, person):
        person.answer("Port of the relay board", "/dev/nothing")
        person.answer("look under /dev/serial/by-path", board.port)
        person.answer("Kind of the relay board", "")
        person.answer("an answer is needed", "banana")
        person.answer("unknown kind of relay board", "lcus")
        person.answer("on one channel", "perhaps")
        person.answer("expected yes or no; found 'perhaps'", "yes")
        person.answer("Number of relays", "99")
        person.answer("at most 8 channels", "4")
        person.answer("contacts may carry", "")
        person.answer("Voltage of the heating supply [V] [11]", "eleven")
        person.answer("invalid number; expected one such as 3.6; found 'eleven'", "-3")
        person.answer("invalid supply.voltage_v", "")
        person.answer("shared)? [each]", "shared")
        person.answer("springs in series need supply.outputs: each", "each")
        person.answer("Current limit of an output [A], or unknown [unknown]", "3.4")
        person.answer("Measured resistance", "98")
        person.answer("does not fit", "0.99")
        person.answer("Temperature of the air", "12")
        person.answer("expected 18 to 30 C", "21.5")
        person.answer("Fan:", "interlocked")
        person.answer("Relay channel that runs the fan", "1")
        person.answer("also heats a spring", "none")
        person.answer("Independent cut-off", "timer")
        person.answer("Longest time", "6.3")
        person.answer("Camera:", "camera:x")
        person.answer("invalid name of a camera", "none")
        person.type_ahead("no")  # no answer to what is asked later
        person.answer("Warm one spring after the other", "yes")
        assert not board.contact_events
        person.wait_for("channel 1:")
        person.type_ahead("0")  # nor to the question that comes when the contact has opened
        for spring, answer in ((0, "1"), (1, "2")):
            person.answer(f"Did spring {spring} front and back in series grow warm?", answer)
            assert not any(board.contacts)
        person.answer("expected a number from 0 to 1; found 2", "0")
        assert program.wait(30) == 0
        said = person.read_rest()
        assert [(e.channel, e.closed) for e in board.contact_events] == [
            (1, True),
            (1, False),
            (2, True),
            (2, False),
        ]
    assert "Corrected channels" in said and f"next: eldir gait design.json --rig {path}" in said
    rig = Rig.load(path)
    assert set(rig.channels) == {Connection(1, 1, "both"), Connection(2, 0, "both")}
    assert (rig.supply.current_limit_a, rig.springs.resistance_ohm, rig.springs.ambient_c) == (
        3.4,
        0.99,
        21.5,
    )
    assert rig.fan.interlocked and rig.cutoff_s == 6.3 and rig.camera is None
    text = path.read_text()
    assert text.count("\nfan: ") == 1 and "# fan: {" not in text, "the example became the entry"


def test_it_continues_after_ctrl_c(tmp_path):
    path = tmp_path / "rig.yaml"
    with emulated("lcus", 8) as board:
        words = ("-m", "eldir", "rig", "setup", "--out", path, "--port", board.port, "--board", "lcus")
        with at_a_terminal(*words, "--no-in-series", "--channels", "8", "--contact-rating", "7") as (
            program,
            person,
        ):
            person.answer("Voltage of the heating supply [V] [11]", "12.5")
            person.answer("(shared)?", "")
            program.send_signal(signal.SIGINT)
            assert program.wait(20) == 130
            said = person.read_rest()
        assert f"the answers so far are in {path}; continue: eldir rig setup --out {path}" in said
        assert Rig.load(path).supply.voltage_v == 12.5
        path.write_text("# mine\n" + path.read_text())
        path.chmod(0o600)  # it may have passwords
        continued = run("setup", "--out", path, "--port", board.port, *options(voltage="12"))
        assert continued.exit_code == 0, continued.output
        assert "next: see whether the right springs grow warm: eldir rig doctor" in continued.output
        assert not board.contact_events
    rig = Rig.load(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert (rig.supply.voltage_v, rig.board.channels) == (12, 8) and path.read_text().startswith("# mine\n")


def test_ctrl_c_at_a_question_about_heat_stops_everything(tmp_path):
    path = tmp_path / "rig.yaml"
    with emulated("lcus", 8) as board:
        words = ("-m", "eldir", "rig", "setup", "--out", path, "--port", board.port, *options())
        with at_a_terminal(*words, "--warm") as (program, person):
            person.answer("Switch the heating supply on, then press Enter", "")
            person.wait_for("Did spring 0 front grow warm?")
            program.send_signal(signal.SIGINT)
            assert program.wait(20) == 130
            said = person.read_rest()
        assert [(e.channel, e.closed) for e in board.contact_events] == [(1, True), (1, False)]
        assert "all contacts are open" in said and f"the answers so far are in {path}" in said
        refused = run("setup", "--out", path, "--port", board.port, *options())
        assert refused.exit_code == 1 and "FAIL  emergency stop" in refused.output
        assert run("reset", "--rig", path).exit_code == 0


@pytest.mark.parametrize("missing", [*ANSWERS, "--port", "--in-series"])
def test_a_missing_answer_without_a_terminal_is_refused_by_name(missing, tmp_path):
    """The value of a cut-off or a fan's channel is asked for once there is one."""
    with emulated("lcus") as board:
        given = [w for w in ("--port", board.port)] if missing != "--port" else []
        words = options(**{missing[2:].replace("-", "_"): None})[missing == "--in-series" :]
        refused = run("setup", "--out", tmp_path / "rig.yaml", *given, *words)
    assert refused.exit_code == 2 and f"Invalid value for {missing}: an answer for each" in refused.output
    assert not (tmp_path / "rig.yaml").exists()


def test_all_missing_answers_are_named_at_once_without_a_terminal(tmp_path):
    refused = run("setup", "--out", tmp_path / "rig.yaml", "--fan", "none", "--voltage", "11")
    said = refused.output.partition("Invalid value for ")[2]
    named = re.findall("--[a-z-]+", said.partition(": an answer")[0])
    others = [o for o in ANSWERS if o not in ("--fan", "--fan-channel", "--voltage", "--cutoff-value")]
    assert sorted(named) == sorted(["--port", "--in-series", *others])


def test_a_rig_that_would_not_arm_is_not_told_to_be_ready(tmp_path):
    """A contactor stays closed where the board does not open it by itself; a contact is too weak."""
    with emulated("lcus", 8) as board:
        for changes, said in (
            ({"cutoff": "contactor", "cutoff_value": "8"}, "a board that times its pulses"),
            ({"contact_rating": "2"}, "the current exceeds the relay contacts' rating"),
        ):
            path = tmp_path / f"{len(said)}.yaml"
            result = run("setup", "--out", path, "--port", board.port, *options(**changes))
            assert result.exit_code == 1 and "FAIL  a welded contact" in result.output
            assert said in result.output and "next: correct it" in result.output


def test_what_is_unknown_stays_null_and_nothing_heats(tmp_path):
    path = tmp_path / "rig.yaml"
    with emulated("modbus") as board:
        answers = options(board="modbus", resistance="unknown", cutoff="none", cutoff_value=None)
        result = run("setup", "--out", path, "--port", board.port, *answers)
        assert result.exit_code == 1 and not board.contact_events
    assert "springs.resistance_ohm stays null: without it the rig will not arm" in result.output
    assert (
        "FAIL  measurements" in result.output and "next: correct it, then eldir rig doctor" in result.output
    )
    assert Rig.load(path).springs.resistance_ohm is None


@pytest.fixture
def stream() -> Iterator[tuple[str, TagBoard]]:
    """A camera in the network that sees six reference tags, 1 mm a pixel."""
    board = TagBoard.at(np.array([(x, y) for y in (0.1, 0.3) for x in (0.1, 0.3, 0.5)]))
    picture = np.full((400, 640, 3), 200, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for number, (x, y) in enumerate(board.centres):
        marker = cv2.aruco.generateImageMarker(dictionary, number, 60)
        top, left = 399 - round(1000 * y) - 30, round(1000 * x) - 30
        picture[top - 8 : top + 68, left - 8 : left + 68] = 255
        picture[top : top + 60, left : left + 60] = marker[..., None]
    data = cv2.imencode(".jpg", picture)[1].tobytes()
    head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n".encode()

    class Camera(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            with suppress(OSError):
                while True:
                    self.wfile.write(head + data + b"\r\n")
                    time.sleep(0.05)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Camera) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/video", board
        server.shutdown()


def test_the_camera_and_its_plane_are_written(stream, tmp_path):
    """Its size is what it gives; the lens is left for later."""
    path = tmp_path / "rig.yaml"
    address, tags = stream
    tags.save(tmp_path / "tags.json")
    with emulated("lcus", 8) as board:
        words = ("-m", "eldir", "rig", "setup", "--out", path, "--port", board.port, *options(camera=address))
        with at_a_terminal(*words, "--no-warm") as (program, person):
            person.answer("the reference tags", "none.json")
            person.answer("none.json does not exist", "")
            person.answer("Calibrate the lens now?", "")
            person.wait_for("Later: eldir calibrate camera http://127")
            person.answer("Calibrate the plane now?", "y")
            assert program.wait(30) in (0, 1)  # a busy computer shows fewer frames
            said = person.read_rest()
    assert (
        "6 tags fit within" in said and "1.000 mm per pixel" in said and "plane.json is 0.0 days old" in said
    )
    camera = Rig.load(path).camera
    assert (camera.device, camera.width, camera.height) == (address, 640, 400)
    assert (camera.lens, camera.plane, camera.tags) == (None, "plane.json", "tags.json")


FIND = """
import sys
from pathlib import Path
from eldir.errors import EldirError
from eldir_app.rig_setup.devices import find_replugged
from eldir_app.rig_setup.dialogue import Dialogue
from eldir_hardware.clock import VirtualClock
try:
    print("found", find_replugged(Dialogue(), Path(sys.argv[1]), VirtualClock()))
except EldirError as error:
    print(error)
"""


@pytest.mark.parametrize(("unplugged", "said"), [(1, "found {}/usb-2"), (0, "0 serial ports vanished")])
def test_the_board_is_found_by_unplugging_it(unplugged, said, tmp_path):
    """Of two boards, one has another kernel name when it comes back."""
    with emulated("lcus") as other, emulated("lcus") as board, emulated("lcus") as again:
        links = [tmp_path / "usb-1", tmp_path / "usb-2"]
        for link, port in zip(links, (other.port, board.port), strict=True):
            link.symlink_to(port)
        with at_a_terminal("-c", FIND, tmp_path) as (program, person):
            person.wait_for("Unplug the USB cable of the relay board")
            if unplugged:
                links[1].unlink()
            person.answer("then press Enter: ", "")
            if unplugged:
                person.wait_for("Plug it in again")
                links[1].symlink_to(again.port)
                person.answer("then press Enter: ", "")
            assert program.wait(20) == 0
            assert said.format(tmp_path) in person.read_rest()


def test_no_answer_that_was_typed_before_a_question_counts():
    host, guest = pty.openpty()
    dialogue = Dialogue(guest)
    os.write(host, b"yes\nyes\n")
    assert dialogue.poll_line() == "yes"
    dialogue.discard()
    assert dialogue.poll_line() is None
    os.close(host)
    os.close(guest)


def wired(felt: dict[int, str], rig: Rig = RIG) -> tuple[Connection, ...]:
    """The wiring that follows from what a person feels at each channel, in virtual time."""
    host, guest = pty.openpty()
    springs = FeltSprings(rig, Dialogue(guest))
    closed = []

    def is_answered(connection: Connection) -> bool:
        answered = springs.is_answered(connection)
        closed.append(sum(virtual.emulator.contacts))
        if not answered and (answer := felt.pop(connection.channel, "")):
            os.write(host, f"{answer}\n".encode())
            assert select.select([guest], [], [], 5)[0]
        return answered

    try:
        with VirtualRig(rig, Piston()) as virtual:
            bank = PulseController(virtual.board, rig, virtual.clock)
            length = warming_pulse(rig)
            warm_each(bank, virtual.clock, rig.channels, length, lambda c: None, is_answered=is_answered)
            times = np.array([event.t for event in virtual.emulator.contact_events]).reshape(-1, 2)
        assert len(times) == len(rig.channels) and not any(closed)
        assert (times[1:, 0] - times[:-1, 1]).min() > PAUSE_S - 0.2, "the same spring may be wired twice"
        return springs.find_wiring()
    finally:
        os.close(host)
        os.close(guest)


def test_the_wiring_is_what_was_felt():
    assert wired({1: "y", 2: "y", 3: "y", 4: "y"}) == RIG.channels
    assert wired({1: "1 back", 2: "y", 3: "1 front", 4: "0 front"}) == (
        Connection(1, 1, "back"),
        Connection(2, 0, "back"),
        Connection(3, 1, "front"),
        Connection(4, 0, "front"),
    )
    with pytest.raises(InputError, match="no spring of channels 2, 4 grew warm"):
        wired({1: "y", 2: "n", 3: "y", 4: "n"})
    with pytest.raises(InputError, match="spring 0 front grew warm at channels 1, 2"):
        wired({1: "y", 2: "0 front", 3: "y", 4: "y"})
