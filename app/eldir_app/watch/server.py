"""The server of the page: files, a WebSocket that only sends, pictures, and the stop."""

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
from eldir_app.watch.access import Access, GuardedApp
from eldir_app.watch.admission import AdmissionControl
from eldir_app.watch.followed_run import FollowedRun
from eldir_app.watch.rig_control import EmergencyStop, ScheduleStart
from eldir_app.watch.run_view import PagePosition
from eldir_hardware.run.remote_control import COMMANDS, send_command

MAX_PAGES = 40
"""More pages at once are refused; they can still stop."""
_MIN_INTERVAL_S = 0.1  # between two messages to a page
_HEARTBEAT_S = 0.5  # a page that receives nothing for longer reports that the server is gone
_ACCEPTED_TOGETHER = 16  # connections that are accepted before requests are served again
_BACKLOG = 4096  # connections that may wait until they are accepted
_WRONG_TOKEN_DELAY_S = 0.5
_TIMESTAMP = struct.Struct("<d")
_PAGE_FOLDER = Path(__file__).parent / "page"
_MEDIA_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}


class Server:
    """Answers the requests of the pages of one server."""

    def __init__(
        self, run: FollowedRun, access: Access, stop: EmergencyStop, start: ScheduleStart | None = None
    ):
        self._run, self._access, self._stop, self._start = run, access, stop, start
        self._pages = 0

    def application(self) -> GuardedApp:
        """The ASGI application."""
        files = [Route(f"/{p.name}", _file(p)) for p in _PAGE_FOLDER.iterdir() if p.name != "page.html"]
        routes = [
            Route("/", _file(_PAGE_FOLDER / "page.html")),
            *files,
            Route("/picture", self._picture),
            Route("/stop", self._on_stop, methods=["POST"]),
            Route("/start", self._on_start, methods=["POST"]),
            Route("/order/{word}", self._on_order, methods=["POST"]),
            Route("/enter", self._enter, methods=["POST"]),
            WebSocketRoute("/socket", self._socket),
        ]
        return GuardedApp(Starlette(routes=routes, lifespan=self._follow), self._access)

    @contextlib.asynccontextmanager
    async def _follow(self, _: Starlette) -> AsyncIterator[None]:
        reading = asyncio.create_task(self._run.run())
        yield
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)

    async def _on_stop(self, _: Request) -> Response:
        if self._run.is_replay:
            return JSONResponse(
                {"proven": False, "text": "this page shows a finished log: there is nothing to stop"}, 409
            )
        return JSONResponse((await self._stop.stop())._asdict())

    async def _on_start(self, _: Request) -> Response:
        """Start the one schedule that this server may start."""
        if self._start is None:
            return JSONResponse(
                {
                    "taken": False,
                    "text": "starting is not allowed here; restart eldir rig watch with --allow-start",
                },
                409,
            )
        try:
            self._start.start(self._run.is_driven)
        except EldirError as error:
            return JSONResponse({"taken": False, "text": str(error)}, 409)
        return JSONResponse({"taken": True, "text": ""})

    async def _on_order(self, request: Request) -> Response:
        """Send pause, resume, step or finish to the driving program, which may not answer."""
        word = request.path_params["word"]
        if word not in COMMANDS:
            return Response(status_code=404)
        taken = [await asyncio.to_thread(send_command, player, word) for player in self._run.players]
        return JSONResponse({"taken": bool(taken) and all(taken)})

    async def _enter(self, request: Request) -> Response:
        if not self._access.has_bearer_token(request.headers):
            await asyncio.sleep(_WRONG_TOKEN_DELAY_S)
            return Response("wrong token\n", 401)
        return Response(status_code=204, headers={"set-cookie": self._access.cookie})

    async def _picture(self, request: Request) -> Response:
        try:
            t = float(request.query_params.get("t", ""))
        except ValueError:
            return Response(status_code=404)
        data = self._run.picture_at(t)
        return Response(status_code=404) if data is None else Response(data, media_type="image/jpeg")

    async def _socket(self, page: WebSocket) -> None:
        if self._pages >= MAX_PAGES:
            await page.close(1013)
            return
        await page.accept()
        self._pages += 1
        receiving = asyncio.create_task(page.receive())
        sending = asyncio.create_task(self._send_news(page))
        try:
            await asyncio.wait({receiving, sending}, return_when=asyncio.FIRST_COMPLETED)
            message = receiving.result() if receiving.done() and not receiving.exception() else None
            if message is not None and message["type"] == "websocket.receive":
                await page.close(1008)  # pages must not send anything
        finally:
            self._pages -= 1
            receiving.cancel()
            sending.cancel()
            await asyncio.gather(receiving, sending, return_exceptions=True)

    async def _send_news(self, page: WebSocket) -> None:
        """Send what is new, at most every `_MIN_INTERVAL_S`. A slow page gets fewer and longer messages."""
        sent_state: dict[str, Any] = {}
        position, run, picture_t = PagePosition(), -1, -1.0
        while True:
            start = time.monotonic()
            view = self._run.view
            if run != self._run.number:
                position, run, picture_t = PagePosition(), self._run.number, -1.0
            news: dict[str, Any] = {}
            if view is not None:
                news, position = view.news(position)
            state = self._state()
            news |= {k: v for k, v in state.items() if sent_state.get(k, ...) != v}
            sent_state = state
            await page.send_text(json.dumps(news, separators=(",", ":")))
            if view is not None and view.picture is not None and view.picture[0] > picture_t:
                picture_t, data = view.picture
                await page.send_bytes(_TIMESTAMP.pack(picture_t) + data)
            await asyncio.sleep(start + _MIN_INTERVAL_S - time.monotonic())
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._run.wait_for_change(), start + _HEARTBEAT_S - time.monotonic())

    def _state(self) -> dict[str, Any]:
        run, view = self._run, self._run.view
        state: dict[str, Any] = {"rig": run.rig_state, "replay": run.is_replay, "ended": run.has_ended}
        state |= {"behind": run.is_behind, "orders": bool(run.players)}
        if self._start is not None:
            idle = not (run.is_driven or self._start.is_running)
            state |= {"start": self._start.schedule.name if idle else None, "failure": self._start.failure}
        state |= {"trouble": run.problem, "now": run.now}
        if view is not None:
            state |= {"log": view.path.name, "plan": view.plan, "latest": view.latest}
            state |= {"ground": view.ground, "paused": view.paused, "camera_rate": view.camera_rate}
            state |= {"prediction": view.prediction, "tracked_share": view.tracked_share}
        return state


def serve(
    run: FollowedRun,
    access: Access,
    stop: EmergencyStop,
    start: ScheduleStart | None,
    listening: socket.socket,
    on_ready: Callable[[], None],
) -> None:
    """Serve until Ctrl-C or SIGTERM; `on_ready` is called when the page can be opened."""
    application = Server(run, access, stop, start).application()
    config = uvicorn.Config(
        application,
        log_level="error",
        access_log=False,
        server_header=False,
        http=AdmissionControl(application.is_stop),  # type: ignore[arg-type]  # called like a protocol class
        backlog=_ACCEPTED_TOGETHER,
        ws="websockets-sansio",
        ws_max_size=1024,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )
    on_ready()
    sys.stdout.flush()
    _Uvicorn(config).run(sockets=[listening])


class _Uvicorn(uvicorn.Server):
    """A server with a long backlog: a client that finds the kernel's queue full waits for a second."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)  # sets the kernel's queue to uvicorn's backlog, `_ACCEPTED_TOGETHER`
        for each in sockets or ():
            each.listen(_BACKLOG)


def _file(path: Path) -> Callable[[Request], Any]:
    data, kind = path.read_bytes(), _MEDIA_TYPES[path.suffix]

    async def answer(_: Request) -> Response:
        return Response(data, media_type=kind)

    return answer
