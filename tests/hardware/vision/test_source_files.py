"""Tables of times as people write them, films without times, other files, and a stream that breaks off."""

from __future__ import annotations

import re
import sqlite3
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import av
import cv2
import pytest
import zstandard
from typer.testing import CliRunner, Result

from eldir.errors import InputError
from eldir.trajectory import Trajectory
from eldir_app.application import application
from eldir_hardware.vision.sources import open_source
from tests.eldir.random_design import make_design
from tests.hardware.vision.numbered_films import number_in, numbered
from tests.hardware.vision.walking_films import TIMES, rms_mm, truth
from tests.raised import raises


def eldir(*words: str | Path) -> Result:
    return CliRunner().invoke(application(str(words[0])), [str(word) for word in words])


def said(result: Result) -> str:
    return " ".join(f"{result.output} {result.exception}".replace("│", " ").split())


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    for number in range(12):
        cv2.imwrite(str(tmp_path / f"{number}.png"), numbered(number))
    return tmp_path


def table(separator: str = ",", order: list[int] | None = None) -> str:
    return "\n".join(
        [f"file{separator}t_s", *(f"{n}.png{separator}{0.1 * n:.1f}" for n in order or range(12))]
    )


@pytest.mark.parametrize(
    "content",
    [
        table().encode(),
        table().encode("utf-8-sig"),
        table(";").encode("utf-8-sig"),
        table("\t").encode(),
        table(" , ").encode(),
        table("  ").encode(),
        table(";").replace(";0.", ";0,").replace(";1.", ";1,").encode(),
        table(order=[3, 1, 2, 0, *range(11, 3, -1)]).encode(),
        (table().replace("\n", "\r\n") + "\r\n\r\n").encode(),
    ],
    ids=["plain", "bom", "semicolons", "tabs", "spaces", "only spaces", "decimal commas", "unsorted", "crlf"],
)
def test_a_table_of_times_is_read_as_a_spreadsheet_writes_it(pictures: Path, content: bytes) -> None:
    (pictures / "times.csv").write_bytes(content)
    found = [(round(t, 6), number_in(image)) for t, image in open_source(pictures)]
    assert found == [(round(0.1 * n, 6), n) for n in range(12)]


def test_a_table_without_times_of_its_own_is_refused(pictures: Path) -> None:
    times = pictures / "times.csv"
    times.write_text("file,t_s\n" + "".join(f"{n}.png,{0.1 * (n // 4):.1f}\n" for n in range(12)))
    with raises(InputError, "film.wrong-timestamps", match=r"times\.csv .*found 3 different times of 12"):
        list(open_source(pictures))
    times.write_text(table(), "utf-16")
    with raises(InputError, "file.damaged", match=r"times\.csv .*expected a table \(CSV\) in UTF-8"):
        list(open_source(pictures))


def test_a_film_without_times_is_tracked_at_the_rate_that_is_given(recordings: Path, tmp_path: Path) -> None:
    """OpenCV reads such a film at 25 pictures a second, or all of them at 0 s."""
    raw = tmp_path / "walk.mjpeg"
    with av.open(str(recordings / "walk.avi")) as film:
        raw.write_bytes(b"".join(bytes(packet) for packet in film.demux(video=0)))
    call = ["track", raw, "--tags", recordings / "tags.json", "--out", tmp_path / "walk.json"]
    result = eldir(*call)
    assert result.exit_code == 1 and "has no timestamps" in said(result) and "--rate" in said(result)
    assert eldir(*call, "--rate", "10").exit_code == 0
    found = Trajectory.load(tmp_path / "walk.json")
    assert found.times.tolist() == pytest.approx(TIMES[:20].tolist())
    assert rms_mm(found.positions, truth(TIMES[:20])) < 0.3
    result = eldir("track", recordings / "walk.avi", *call[2:-1], tmp_path / "no.json", "--rate", "10")
    assert result.exit_code == 2 and "has timestamps; remove it" in said(result)


@pytest.mark.parametrize(
    "call",
    [
        ["track", "--out", "out.json"],
        ["report", "--design", "design.json", "--out", "out"],
        ["recover", "--out", "out.mcap"],
        ["runs"],
    ],
    ids=lambda call: call[0],
)
@pytest.mark.parametrize("name", ["bag_0.mcap.zstd", "walk.bag", "walk.db3"])
def test_another_recording_is_named_for_what_it_is(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: list[str], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    make_design().save(tmp_path / "design.json")
    if name.endswith(".zstd"):
        Path(name).write_bytes(zstandard.compress((recordings / "walk.mcap").read_bytes()))
        line = f"{name} is compressed with zstd as a whole; .*zstd -d {name}"
    elif name.endswith(".bag"):
        Path(name).write_bytes(b"#ROSBAG V2.0\n" + bytes(4096))
        line = f"{name} is a bag of ROS 1; .*name the log that the run itself wrote"
    else:
        with sqlite3.connect(name) as database:
            database.execute("create table messages(id integer)")
        database.close()
        line = f"{name} is an SQLite database, such as a bag of ROS 2 .*the log that the run itself wrote"
    result = eldir(call[0], name, *call[1:])
    assert result.exit_code == 1
    assert re.search(line, said(result))
    assert not list(tmp_path.glob("out*"))


@pytest.fixture
def stream(recordings: Path) -> Iterator[str]:
    """A camera in the network that breaks off after twenty pictures, a tenth of a second apart."""
    with av.open(str(recordings / "walk.avi")) as film:
        frames = [bytes(packet) for packet in film.demux(video=0) if packet.size]
    stop = threading.Event()

    class Camera(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            for data in frames:
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                self.wfile.write(head.encode() + data + b"\r\n")
                stop.wait(0.02)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Camera)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/video"
    stop.set()
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_stream_that_breaks_off_leaves_what_came(stream: str, recordings: Path, tmp_path: Path) -> None:
    out, plane = tmp_path / "walk.json", tmp_path / "plane.json"
    assert eldir("calibrate", "plane", recordings / "walk.mcap", "--out", plane).exit_code == 0
    result = eldir("track", stream, "--plane", plane, "--seconds", "60", "--out", out)
    found = Trajectory.load(out)
    assert 15 < len(found.times) <= 20
    assert rms_mm(found.positions, truth(TIMES[: len(found.times)])) < 0.3
    assert result.exit_code == 1
    assert f"{out} holds only the first {found.times[-1]:.1f} s" in said(result)
    assert "gives no picture any more" in said(result)
