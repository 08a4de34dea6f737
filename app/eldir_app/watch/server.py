"""The server of the page: files, a socket that only speaks, pictures, and the Stop."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import struct
import sys
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from eldir.errors import EldirError
from eldir_app.watch.access import Access, Guarded
from eldir_app.watch.connection import AdmissionControl
from eldir_app.watch.follow import Follow
from eldir_app.watch.start import Start
from eldir_app.watch.stop import Stop
from eldir_app.watch.view import Seen
from eldir_hardware.run.orders import ORDERS, give_order

MOST_PAGES = 40
"""More pages at once are refused; they can still stop."""
_INTERVAL = 0.1  # from one message to the next [s]
_HEARTBEAT = 0.5  # a page that hears nothing for longer knows that the server has gone [s]
_AT_ONCE = 16  # connections that are accepted before anything else is looked at
_QUEUE = 4096  # connections that may wait until they are accepted
_WRONG_TOKEN = 0.5  # before the answer to a wrong token [s]
_STAMP = struct.Struct("<d")
_PAGE = Path(__file__).parent / "page"
_KINDS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}


class Server:
    """Answers of one server."""

    def __init__(self, follow: Follow, access: Access, stop: Stop, start: Start | None = None):
        self._follow, self._access, self._stop, self._start = follow, access, stop, start
        self._pages = 0

    def application(self) -> Guarded:
        """The ASGI application."""
        files = [Route(f"/{p.name}", _file(p)) for p in _PAGE.iterdir() if p.name != "page.html"]
        routes = [
            Route("/", _file(_PAGE / "page.html")),
            *files,
            Route("/picture", self._picture),
            Route("/stop", self._on_stop, methods=["POST"]),
            Route("/start", self._on_start, methods=["POST"]),
            Route("/order/{word}", self._on_order, methods=["POST"]),
            Route("/enter", self._enter, methods=["POST"]),
            WebSocketRoute("/socket", self._socket),
        ]
        return Guarded(Starlette(routes=routes, lifespan=self._following), self._access)

    @contextlib.asynccontextmanager
    async def _following(self, _: Starlette) -> AsyncIterator[None]:
        reading = asyncio.create_task(self._follow.run())
        yield
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)

    async def _on_stop(self, _: Request) -> Response:
        if self._follow.replay:
            return JSONResponse({"proven": False, "text": "this page replays a log: it stops nothing"}, 409)
        return JSONResponse((await self._stop.stop())._asdict())

    async def _on_start(self, _: Request) -> Response:
        """Start the one schedule that this server may start."""
        if self._start is None:
            return JSONResponse({"taken": False, "text": "this page starts nothing: --allow-start"}, 409)
        try:
            self._start.start(bool(self._follow.driven))
        except EldirError as error:
            return JSONResponse({"taken": False, "text": str(error)}, 409)
        return JSONResponse({"taken": True, "text": ""})

    async def _on_order(self, request: Request) -> Response:
        """Pause, resume, step or finish: told to the program that drives, which may not answer."""
        word = request.path_params["word"]
        if word not in ORDERS:
            return Response(status_code=404)
        players = self._follow.players
        told = [await asyncio.to_thread(give_order, player, word) for player in players]
        return JSONResponse({"taken": bool(told) and all(told)})

    async def _enter(self, request: Request) -> Response:
        if not self._access.is_token(request.headers):
            await asyncio.sleep(_WRONG_TOKEN)
            return Response("wrong token\n", 401)
        return Response(status_code=204, headers={"set-cookie": self._access.cookie})

    async def _picture(self, request: Request) -> Response:
        try:
            t = float(request.query_params.get("t", ""))
        except ValueError:
            return Response(status_code=404)
        data = self._follow.picture_at(t)
        return Response(status_code=404) if data is None else Response(data, media_type="image/jpeg")

    async def _socket(self, page: WebSocket) -> None:
        if self._pages >= MOST_PAGES:
            await page.close(1013)
            return
        await page.accept()
        self._pages += 1
        listening = asyncio.create_task(page.receive())
        speaking = asyncio.create_task(self._speak(page))
        try:
            await asyncio.wait({listening, speaking}, return_when=asyncio.FIRST_COMPLETED)
            said = listening.result() if listening.done() and not listening.exception() else None
            if said is not None and said["type"] == "websocket.receive":
                await page.close(1008)  # pages have nothing to say here
        finally:
            self._pages -= 1
            listening.cancel()
            speaking.cancel()
            await asyncio.gather(listening, speaking, return_exceptions=True)

    async def _speak(self, page: WebSocket) -> None:
        """What is new, at most every `_INTERVAL`. A page that is slow gets less often more."""
        told: dict[str, Any] = {}
        seen, run, shown = Seen(), -1, -1.0
        while True:
            begun = time.monotonic()
            view = self._follow.view
            if run != self._follow.number:
                seen, run, shown = Seen(), self._follow.number, -1.0
            news: dict[str, Any] = {}
            if view is not None:
                news, seen = view.news(seen)
            state = self._state()
            news |= {k: v for k, v in state.items() if told.get(k, ...) != v}
            told = state
            await page.send_text(json.dumps(news, separators=(",", ":")))
            if view is not None and view.picture is not None and view.picture[0] > shown:
                shown, data = view.picture
                await page.send_bytes(_STAMP.pack(shown) + data)
            await asyncio.sleep(begun + _INTERVAL - time.monotonic())
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._follow.changed(), begun + _HEARTBEAT - time.monotonic())

    def _state(self) -> dict[str, Any]:
        follow, view = self._follow, self._follow.view
        state: dict[str, Any] = {"rig": follow.state, "replay": follow.replay, "ended": follow.ended}
        state |= {"orders": bool(follow.players)}
        if self._start is not None:
            free = not (follow.driven or self._start.is_running)
            state |= {"start": self._start.schedule.name if free else None, "failure": self._start.failure}
        state |= {"trouble": follow.trouble, "now": follow.now}
        if view is not None:
            state |= {"log": view.path.name, "plan": view.plan, "latest": view.latest}
            state |= {"paused": view.paused, "camera_rate": view.camera_rate}
        return state


def serve(
    follow: Follow,
    access: Access,
    stop: Stop,
    start: Start | None,
    listening: socket.socket,
    ready: Callable[[], None],
) -> None:
    """Serve until Ctrl-C or SIGTERM; `ready` is called when the page can be opened."""
    application = Server(follow, access, stop, start).application()
    config = uvicorn.Config(
        application,
        log_level="error",
        access_log=False,
        server_header=False,
        http=AdmissionControl(application.is_stop),  # type: ignore[arg-type]  # is called as the class of a protocol
        backlog=_AT_ONCE,
        ws="websockets-sansio",
        ws_max_size=1024,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )
    ready()
    sys.stdout.flush()
    _Uvicorn(config).run(sockets=[listening])


class _Uvicorn(uvicorn.Server):
    """A server at which many may wait: who finds the kernel's queue full tries again after a second."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)  # makes the queue as long as the backlog, which is `_AT_ONCE`
        for each in sockets or ():
            each.listen(_QUEUE)


def _file(path: Path) -> Callable[[Request], Any]:
    data, kind = path.read_bytes(), _KINDS[path.suffix]

    async def answer(_: Request) -> Response:
        return Response(data, media_type=kind)

    return answer
