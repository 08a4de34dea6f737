"""Services that get words: one that takes them, one that never answers, and a camera that stops."""

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

RATE = 10.0  # pictures a second


@contextmanager
def _served(handler: type[BaseHTTPRequestHandler]) -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextmanager
def receiver(status: int = 200) -> Iterator[tuple[str, list[tuple[float, str]]]]:
    """Its address, and when which words came: title and text in one."""
    words: list[tuple[float, str]] = []

    class Taking(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            told = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            words.append((time.monotonic(), f"{told['title']} | {told['message']}"))
            self.send_response(status)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Nothing."""

    with _served(Taking) as place:
        yield f"json://{place}/", words


@contextmanager
def mute() -> Iterator[str]:
    """The address of a service that takes connections and says nothing."""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen(8)
        yield f"json://127.0.0.1:{listening.getsockname()[1]}/?rto=60&cto=60"


@contextmanager
def camera(picture: bytes, lasting: float) -> Iterator[str]:
    """The address of a stream of one JPEG picture that ends after so long [s]."""

    class Phone(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=next")
            self.end_headers()
            begun = time.monotonic()
            for number in range(round(lasting * RATE)):
                time.sleep(max(begun + number / RATE - time.monotonic(), 0))
                head = f"--next\r\nContent-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n"
                try:
                    self.wfile.write(head.encode() + picture + b"\r\n")
                except OSError:  # nobody looks any more
                    return

        def log_message(self, *_: object) -> None:
            """Nothing."""

    with _served(Phone) as place:
        yield f"http://{place}/video"
