"""The server of the page: one port, one token, sessions of several tabs, and its end."""

from __future__ import annotations

import asyncio
import atexit
import errno
import functools
import hmac
import logging
import os
import secrets
import signal
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Sequence
from html import escape
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from types import FrameType
from urllib.parse import parse_qs

import uvicorn
from fastapi import FastAPI, Response
from nicegui import Client, run, ui
from nicegui import app as nicegui_app
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from lieid_casadi.effects.registry import REGISTER
from lieid_casadi.errors import LieidError, UsageError
from lieid_casadi.report import effect_page
from lieid_casadi.workbench.arm import ArmMesh
from lieid_casadi.workbench.evaluation import OpenedInputs
from lieid_casadi.workbench.page import build_page
from lieid_casadi.workbench.session import (
    WorkbenchInputs,
    WorkerSetup,
    is_name,
    load_session,
    page_token,
    remove_old_sessions,
)
from lieid_casadi.workbench.workbench import Workbench

LOOPBACK = "127.0.0.1"
LAST_SECONDS = 1.2  # from SIGTERM to the end at the latest
RECONNECT_SECONDS = 20.0  # that a browser which is busy drawing may be silent
KEPT_SECONDS = 120.0  # that the processes of a session run on after its tab was closed
POLICY = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; form-action 'self'"
)


class AccessControl:
    """Lets requests through that have the token and come from the page itself.

    The token is in the URL that the command prints; the answer to it sets a cookie, with which
    the page loads its scripts and opens its socket. A request of another host name (DNS
    rebinding) or of another site's page is refused; ``hosts`` are the values of the header
    ``Host`` that are served, with the port.
    """

    def __init__(self, app: ASGIApp, *, token: str, hosts: set[str], port: int) -> None:
        self._app, self._token, self._hosts = app, token, hosts
        self._cookie = f"lieid-workbench-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve or refuse one request."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        reason = self._refusal(headers)
        stated = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        by_url = self._is_token(stated)
        if not reason and not by_url and not self._is_token(self._cookie_value(headers)):
            reason = "no valid token; open the URL that lieid workbench has printed"
        if reason:
            await self._refuse(scope, receive, send, reason)
            return

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                added = [
                    (b"content-security-policy", POLICY.encode()),
                    (b"referrer-policy", b"no-referrer"),
                    (b"x-content-type-options", b"nosniff"),
                ]
                if by_url:
                    value = f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                    added.append((b"set-cookie", value.encode()))
                message = {**message, "headers": [*message.get("headers", []), *added]}
            await send(message)

        await self._app(scope, receive, sent)

    def _refusal(self, headers: Headers) -> str:
        """Return why a request is refused because of where it comes from, or an empty text."""
        if headers.get("host", "").lower() not in self._hosts:
            return "unknown host name; open the URL that lieid workbench has printed"
        origin = headers.get("origin")
        if origin is not None and origin.partition("://")[2].lower() not in self._hosts:
            return "a page of another site may not use the workbench"
        return ""

    def _cookie_value(self, headers: Headers) -> str:
        cookies = SimpleCookie()
        try:
            cookies.load(headers.get("cookie", ""))
        except CookieError:
            return ""
        return cookies[self._cookie].value if self._cookie in cookies else ""

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self._token.encode())

    async def _refuse(self, scope: Scope, receive: Receive, send: Send, reason: str) -> None:
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": reason})
            return
        await PlainTextResponse(f"lieid workbench: {reason}\n", 403)(scope, receive, send)


class Sessions:
    """The sessions that pages of this server show; new ones have the ``inputs``."""

    def __init__(self, inputs: WorkbenchInputs, setup: WorkerSetup) -> None:
        self.inputs, self._setup = inputs, setup
        self._open: dict[str, Workbench] = {}

    def of(self, name: str) -> Workbench:
        """Return the workbench of a session, which is made if no page shows it."""
        if name in self._open:
            return self._open[name]
        made = Workbench(name if is_name(name) else secrets.token_hex(8), self._setup)
        self._open[made.name] = made
        return made

    def opened(self, name: str) -> OpenedInputs | None:
        """Return what a session has open."""
        return self._open[name].opened if name in self._open else None

    async def close_unused(self, workbench: Workbench) -> None:
        """End the processes of a session that no page shows; it stays saved."""
        await asyncio.sleep(KEPT_SECONDS)
        if not workbench.has_viewers and self._open.get(workbench.name) is workbench:
            del self._open[workbench.name]
            workbench.close()

    def close(self) -> None:
        """End all processes."""
        for workbench in self._open.values():
            workbench.close()


class _Server(uvicorn.Server):
    """A server that reports when it is ready, and that ends soon after SIGTERM."""

    def __init__(
        self, config: uvicorn.Config, ready: Callable[[], None], close: Callable[[], None]
    ) -> None:
        super().__init__(config)
        self._ready, self._close = ready, close

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Stop serving; end the process if that takes longer than `LAST_SECONDS`."""
        if sig == signal.SIGTERM:
            timer = threading.Timer(LAST_SECONDS, self._end)
            timer.daemon = True
            timer.start()
        super().handle_exit(sig, frame)

    def _end(self) -> None:
        """End at once; sessions are saved after every change."""
        self._close()
        os._exit(0)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, then report."""
        await super().startup(sockets)
        self._ready()


def serve(
    inputs: WorkbenchInputs, setup: WorkerSetup, port: int, *, ready: Callable[[str], None]
) -> None:
    """Serve the page until the process is asked to end; raises as `serve_pages`."""
    remove_old_sessions()
    sessions = Sessions(inputs, setup)
    pages = functools.partial(_pages, sessions)
    serve_pages(pages, port, ready=ready, close=sessions.close)


def serve_pages(
    pages: Callable[[str], None],
    port: int,
    *,
    ready: Callable[[str], None],
    close: Callable[[], None],
) -> None:
    """Serve what ``pages`` registers for a token until the process is asked to end.

    ``ready`` is called with the URL once it can be opened, ``close`` at the end.
    """
    logging.getLogger("nicegui").setLevel(logging.ERROR)
    with listening_socket(port) as listener:
        token = page_token()
        url = f"http://{LOOPBACK}:{port}/?token={token}"
        pages(token)
        nicegui_app.on_startup(_without_process_pool)
        app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
        ui.run_with(
            app, show_welcome_message=False, reconnect_timeout=RECONNECT_SECONDS, tailwind=True
        )
        hosts = {f"{LOOPBACK}:{port}", f"localhost:{port}"}
        config = uvicorn.Config(
            AccessControl(app, token=token, hosts=hosts, port=port),
            log_level="error",
            access_log=False,
            server_header=False,
            lifespan="on",
            timeout_graceful_shutdown=1,
            ws_ping_interval=None,
        )
        signal.signal(signal.SIGTERM, _end_quietly)  # uvicorn has stopped by then
        try:
            _Server(config, lambda: ready(url), close).run(sockets=[listener])
        finally:
            close()


def mesh_file(meshes: Sequence[ArmMesh], number: int) -> Response:
    """Return the file of a mesh, or that there is none."""
    if not 0 <= number < len(meshes):
        return Response(status_code=404)
    header = {"Cache-Control": "no-store"}  # another arm has the same addresses
    return Response(meshes[number].stl, media_type="model/stl", headers=header)


def _pages(sessions: Sessions, token: str) -> None:
    """Register the page, the meshes of its arms and the atlas of effects."""

    @ui.page("/", title="lieid workbench")
    async def index(client: Client, session: str = "") -> None:
        workbench = sessions.of(session)
        view = build_page(workbench, token)

        def left() -> None:
            workbench.forget(view)
            if not workbench.has_viewers:
                workbench.background(sessions.close_unused(workbench))

        client.on_delete(left)
        await client.connected()  # returns, too, if the page is given up before
        if not (client.is_deleted or workbench.started):
            workbench.started = True
            await _fill(workbench, sessions.inputs, requested=session)

    @nicegui_app.get("/mesh/{name}/{number}.stl")
    def mesh(name: str, number: int) -> Response:
        opened = sessions.opened(name)
        return mesh_file(() if opened is None else opened.meshes, number)

    @nicegui_app.get("/atlas/{label:path}")
    def atlas(label: str) -> Response:
        if label not in REGISTER:
            return Response(status_code=404)
        return Response(effect_page(label), media_type="text/html")


def _without_process_pool() -> None:
    """Drop NiceGUI's unused pool, whose semaphores outlive a process that is ended at once."""
    run.process_pool = None


def _end_quietly(number: int, frame: FrameType | None) -> None:
    """Let the command end with status 0."""


async def _fill(workbench: Workbench, inputs: WorkbenchInputs, *, requested: str) -> None:
    """Show the saved session with the requested name, otherwise what the command line opens."""
    saved = None
    if requested:
        try:
            saved = load_session(requested)
        except LieidError as error:
            workbench.error = str(error)
    if saved is not None:
        await workbench.open(saved.inputs, saved)
    elif inputs.robot or inputs.fit:
        await workbench.open(inputs)
    else:
        workbench.computing = False
        workbench.changed()


def open_in_browser(url: str) -> None:
    """Open a URL in the user's browser without naming it on a command line, which others can read.

    The browser opens a file that refers to the URL; the file is its owner's, and is deleted when
    the program ends.
    """
    page = f"""<!DOCTYPE html><meta charset="utf-8"><meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0; url={escape(url)}"><a href="{escape(url)}">workbench</a>"""
    handle, name = tempfile.mkstemp(prefix="lieid-workbench-", suffix=".html")  # mode 0600
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(page)
    atexit.register(Path(name).unlink, missing_ok=True)
    threading.Thread(target=webbrowser.open, args=(Path(name).as_uri(),), daemon=True).start()


def listening_socket(port: int) -> socket.socket:
    """Return a socket that listens on a port of this machine alone; raises as `serve`."""
    made = socket.socket()
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((LOOPBACK, port))
        made.listen(128)
    except OSError as error:
        made.close()
        if error.errno == errno.EADDRINUSE:
            raise UsageError(f"--port {port}: is in use; expected a free port") from error
        raise UsageError(f"--port {port}: cannot listen there ({error.strerror})") from error
    made.set_inheritable(False)
    return made
