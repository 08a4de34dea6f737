"""Requests and socket messages that no page sends, from a seed. None of them may change anything."""

import base64
import os
import random
import socket
import struct
from contextlib import suppress

_METHODS = [
    "GET",
    "POST",
    "PUT",
    "DELETE",
    "PATCH",
    "OPTIONS",
    "HEAD",
    "TRACE",
    "CONNECT",
    "post",
    "PO ST",
    "",
]
_PATHS = ["/stop", "/stop/", "//stop", "/stop?x=1", "/%73top", "/STOP", "/enter", "/socket", "/picture?t=nan"]
_PATHS += [
    "/",
    "/picture?t=1e309",
    "/picture?t=-1",
    "/../stop",
    "/page.js/../../stop",
    "*",
    "/\x00",
    "/" + "a" * 9000,
]
_HOSTS = [
    "{host}",
    "evil.example",
    "127.0.0.1.evil.example",
    "",
    "localhost:99999",
    "[::1",
    "127.0.0.1:80:80",
]
_ORIGINS = [
    None,
    "null",
    "http://evil.example",
    "https://{host}",
    "http://{host}.evil.example",
    "http://{host}/",
]
_ORIGINS += ["http://127.0.0.1", "file://", "http://", "ws://{host}", "HTTP://{host}"]
_EXTRAS = [
    "Content-Length: -1",
    "Content-Length: 99999999999",
    "Transfer-Encoding: chunked",
    "Cookie: eldir_watch=",
]
_EXTRAS += [
    "X-Forwarded-Host: {host}",
    "X-HTTP-Method-Override: POST",
    "Authorization: Bearer ",
    "Expect: 100-continue",
]
_EXTRAS += [
    "Content-Length: 3\r\nContent-Length: 4",
    "A" * 9000 + ": 1",
    " folded",
    "Upgrade: websocket",
    ":",
]
_UPGRADE = "GET /socket HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
_UPGRADE += "Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\nOrigin: {origin}\r\n\r\n"


def request(rng: random.Random, host: str) -> bytes:
    """A request without the Origin of our own page, whole or damaged."""
    lines = [f"{rng.choice(_METHODS)} {rng.choice(_PATHS)} HTTP/{rng.choice(['1.1', '1.0', '2.0', '9'])}"]
    lines += [f"Host: {rng.choice(_HOSTS)}"] * rng.choice([0, 1, 1, 1, 2])
    origin = rng.choice(_ORIGINS)
    lines += [] if origin is None else [f"Origin: {origin}"]
    lines += rng.sample(_EXTRAS, rng.randrange(4))
    text = "\r\n".join(lines).replace("{host}", host) + "\r\n\r\n"
    data = bytearray(text.encode("latin-1"))
    if rng.random() < 0.3:
        for _ in range(rng.randint(1, 8)):
            data[rng.randrange(len(data))] = rng.randrange(256)
    if rng.random() < 0.2:
        data = data[: rng.randrange(len(data))]
    return bytes(data) + rng.randbytes(rng.choice([0, 0, 5, 200]))


def frames(rng: random.Random) -> bytes:
    """Frames of a WebSocket: of any kind and length, masked or not, whole or cut off."""
    data = b""
    for _ in range(rng.randint(1, 4)):
        body = rng.choice([b"", b"stop", b'{"stop":true}', rng.randbytes(rng.choice([1, 125, 126, 2000]))])
        first = rng.choice([0x81, 0x82, 0x01, 0x00, 0x88, 0x89, 0x8A, 0xC1, 0x8F, rng.randrange(256)])
        length = len(body) if rng.random() < 0.8 else rng.randrange(1 << 16)
        masked = 0x80 if rng.random() < 0.8 else 0
        data += struct.pack(">BBH", first, masked | 126, length)
        key = rng.randbytes(4)
        data += key + bytes(b ^ key[i % 4] for i, b in enumerate(body)) if masked else body
    return data[: rng.randrange(len(data) + 1)] if rng.random() < 0.2 else data


def pour(host: str, seed: int, count: int) -> int:
    """Send so many, each on a connection of its own; returns how many were answered."""
    rng = random.Random(seed)
    name, port = host.split(":")
    answered = 0
    for number in range(count):
        with suppress(OSError), socket.create_connection((name, int(port)), timeout=0.5) as line:
            if number % 4 == 0:
                origin = rng.choice(["http://" + host, "http://evil.example", "null"])
                key = base64.b64encode(os.urandom(16)).decode()
                line.sendall(_UPGRADE.format(host=host, key=key, origin=origin).encode())
                answered += bool(line.recv(64))
                line.sendall(frames(rng))
            else:
                line.sendall(request(rng, host))
            line.shutdown(socket.SHUT_WR)
            line.settimeout(0.05)
            answered += bool(line.recv(64))
    return answered
