"""Which requests the server accepts: a token, and strict checks of the headers Host and Origin."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import re
import secrets
import socket
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from contextlib import suppress
from typing import Any

from eldir_hardware.safety.state_folder import open_state_folder

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE = "eldir_watch"
_TOKEN_FILE = ".watch-token"  # files without the dot are records of stops
_MIN_TOKEN_LENGTH = 32  # [characters]
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[0-9A-Za-z.-]+)(?::[0-9]{1,5})?")
_OPEN_PATHS = ("/", "/enter")
_OPEN_SUFFIXES = (".css", ".js", ".svg")
"""What a page needs before it can ask for the token; it contains nothing about the rig."""
_STOP, _START = "/stop", "/start"


def load_token() -> str:
    """The token of this user, made on first use. It stays the same, so that open pages work after a restart.

    Raises `EldirError` if the folder of the latched stops cannot be trusted.
    """
    with open_state_folder(exclusive=True) as folder:
        with suppress(FileNotFoundError):
            token = folder.read(_TOKEN_FILE).decode(errors="replace").strip()
            if len(token) >= _MIN_TOKEN_LENGTH:
                return token
        token = secrets.token_urlsafe(32)
        folder.write(_TOKEN_FILE, token.encode())
        return token


class Access:
    """Rules of one server."""

    def __init__(
        self,
        token: str | None,
        names: frozenset[str] = frozenset(),
        free_stop: bool = False,
        local: bool = False,
    ):
        """`token`: None if nothing needs one. `names`: of this computer, besides its own. `free_stop`: the
        stop needs no token. `local`: everybody on this computer may look and stop; only the start needs the
        token."""
        self._secret = None if token is None else _digest(token)
        own_name = socket.gethostname().lower()
        self._names = {"localhost", own_name, f"{own_name}.local", *(n.lower() for n in names)}
        self._free_stop, self._local = free_stop, local

    def knows_host(self, host: str) -> bool:
        """Whether a Host header means this computer: an IP address, which no other site can claim, or a known
        name."""
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        if match[1].lower() in self._names:
            return True
        with suppress(ValueError):
            ipaddress.ip_address(match[1].strip("[]"))
            return True
        return False

    def is_allowed(self, path: str, headers: Mapping[str, str]) -> bool:
        """Whether a request has the token, if its path needs one. The start always does."""
        if path == _START:
            return self._secret is not None and self._has_token(headers)
        if (
            self._local
            or self._secret is None
            or path in _OPEN_PATHS
            or path.endswith(_OPEN_SUFFIXES)
            or (path == _STOP and self._free_stop)
        ):
            return True
        return self._has_token(headers)

    def _has_token(self, headers: Mapping[str, str]) -> bool:
        return self.has_bearer_token(headers) or hmac.compare_digest(_cookie(headers), self._secret or "")

    def has_bearer_token(self, headers: Mapping[str, str]) -> bool:
        """Whether the header `Authorization: Bearer TOKEN` has the token."""
        kind, _, token = headers.get("authorization", "").partition(" ")
        digest = _digest(token.strip())
        return self._secret is None or (kind == "Bearer" and hmac.compare_digest(digest, self._secret))

    @property
    def cookie(self) -> str:
        """For a browser that has sent the token: it contains a digest, not the token."""
        return f"{COOKIE}={self._secret or ''}; Path=/; HttpOnly; SameSite=Strict; Max-Age=2592000"


class GuardedApp:
    """The application behind the rules; it also sets the headers that isolate the page from other sites."""

    def __init__(self, app: App, access: Access):
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = _headers(scope)
        status = self._refusal(scope, headers)
        if status is None:
            await self._app(scope, receive, _with_headers(send, headers.get("host", "")))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            text = {400: "unknown Host", 401: "the token is missing", 403: "foreign Origin"}[status]
            plain = [(b"content-type", b"text/plain")]
            hardened = _with_headers(send, "")
            await hardened({"type": "http.response.start", "status": status, "headers": plain})
            await hardened({"type": "http.response.body", "body": f"{text}\n".encode()})

    def is_stop(self, head: bytes) -> bool:
        """Whether the raw head of a request is that of an allowed stop."""
        if not head.startswith(b"POST /stop "):
            return False
        lines = head.partition(b"\r\n\r\n")[0].split(b"\r\n")[1:]
        pairs = [(name, value.strip()) for name, _, value in (line.partition(b":") for line in lines)]
        scope = {"type": "http", "method": "POST", "path": _STOP, "headers": pairs}
        return self._refusal(scope, _headers(scope)) is None

    def _refusal(self, scope: Scope, headers: Mapping[str, str]) -> int | None:
        """The HTTP status of a refusal; None where the request is allowed."""
        if not self._access.knows_host(headers.get("host", "")):
            return 400
        reads = scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        if not reads and headers.get("origin") != f"http://{headers['host']}":
            return 403  # a page of another site, or no page
        if not self._access.is_allowed(scope["path"], headers):
            return 401
        return None


def _headers(scope: Scope) -> dict[str, str]:
    """Headers by name; a header that occurs twice is empty."""
    headers: dict[str, str] = {}
    for name, value in scope["headers"]:
        key = name.decode("latin-1").lower()
        headers[key] = "" if key in headers else value.decode("latin-1")
    return headers


def _with_headers(send: Send, host: str) -> Send:
    """Add the headers of every answer: close the connection; no foreign script, style, picture or frame."""
    connections = f"'self' ws://{host}" if host else "'self'"
    policy = (
        f"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
        f"connect-src {connections}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    extra = [
        (b"connection", b"close"),  # one request each: idle connections do not use up the places
        (b"content-security-policy", policy.encode()),
        (b"x-content-type-options", b"nosniff"),
        (b"referrer-policy", b"no-referrer"),
        (b"cross-origin-resource-policy", b"same-origin"),
        (b"cross-origin-opener-policy", b"same-origin"),
        (b"cache-control", b"no-store"),
    ]

    async def send_with_headers(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", ()), *extra]
        await send(message)

    return send_with_headers


def _digest(token: str) -> str:
    return hashlib.sha256(b"eldir watch " + token.encode()).hexdigest()


def _cookie(headers: Mapping[str, str]) -> str:
    for part in headers.get("cookie", "").split(";"):
        name, _, value = part.strip().partition("=")
        if name == COOKIE:
            return value if value.isascii() else ""
    return ""
