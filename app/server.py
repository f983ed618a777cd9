"""The dashboard's server: Dash's pages on FastAPI behind one gate, in one process."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable
from typing import Any

import dash
import uvicorn
from dash.backends._fastapi import FastAPIDashServer, reset_current_request, set_current_request
from dash.exceptions import InvalidCallbackReturnValue
from fastapi import FastAPI, Request, Response

import assets
from app import api
from app.pages import shell
from app.runs import RunManager, set_manager
from app.security import Gate, page_csp
from app.settings import Settings, writable
from engine.errors import BadInput

log = logging.getLogger(__name__)

SOCKET_LIMIT = 2**20
GRACE_S = 3


class PageServer(FastAPIDashServer):
    """Dash's FastAPI backend with a policy on every page, no API browser, and callbacks off the event loop."""

    @staticmethod
    def create_app(name: str = "__main__", config: dict[str, Any] | None = None) -> FastAPI:
        server = FastAPI(title="Wattlane", docs_url=None, redoc_url=None, openapi_url=None)
        for key, value in (config or {}).items():
            setattr(server.state, key, value)
        return server

    def setup_index(self, dash_app: dash.Dash) -> None:
        async def index(request: Request) -> Response:
            return page(dash_app, request)

        dash_app._add_url("", index, methods=["GET"])

    def _setup_catchall(self) -> None:
        dash_app = dash.get_app()

        async def catchall(request: Request) -> Response:
            token = set_current_request(request)
            try:
                return page(dash_app, request)
            finally:
                reset_current_request(token)

        self.add_url_rule("{path:path}", catchall, methods=["GET"])

    def serve_callback(self, dash_app: dash.Dash) -> Callable[..., Any]:
        dispatch = super().serve_callback(dash_app)

        async def in_thread(request: Request) -> Response:
            if not isinstance(request.state.json_body, dict):
                return api.answer({"error": "a JSON object was expected"}, 400)
            # Callbacks read logs and draw charts; on the event loop they would hold up every frame.
            try:
                return await asyncio.to_thread(asyncio.run, dispatch(request))
            except InvalidCallbackReturnValue as error:  # found after the callback, which nobody else is told
                log.error("A page's callback answered what can't be sent", exc_info=error)
                told = {shell.Shell.NOTIFY.value: shell.failure()}
                return api.answer({"multi": True, "response": {}, "sideUpdate": told})

        return in_thread


def page(dash_app: dash.Dash, request: Request) -> Response:
    """The page with a policy that allows exactly the scripts in it."""
    html = dash_app.index()
    policy = page_csp(html, request.headers.get("host", ""))
    headers = {"content-security-policy": policy, "cache-control": "no-store"}
    return Response(html, headers=headers, media_type="text/html")


def create_app(settings: Settings) -> dash.Dash:
    """The whole dashboard as a Dash app; `.server` is the ASGI app to serve with one worker.

    Makes the program's RunManager. Raises BadInput when the data folder can't be written.
    """
    writable(settings.runs)
    os.environ.pop("_DASH_FASTAPI_CONFIG", None)  # Dash would switch its debugger on from it
    manager = RunManager(settings)
    set_manager(manager)
    app = dash.Dash(
        "app",
        backend=PageServer,
        assets_folder=str(assets.path("web")),
        serve_locally=True,
        title="Wattlane",
        update_title=None,
        suppress_callback_exceptions=True,
        enable_mcp=False,
        pages_folder="",
        add_log_handler=False,
        on_error=shell.failed,
    )
    app.wattlane_manager = manager
    api.install(app.server, manager, settings.viewer_cache)
    shell.install(app, manager, settings)
    app.server.add_middleware(Gate, settings=settings)
    return app


def bind(settings: Settings) -> socket.socket:
    """The listening socket. Raises BadInput with one sentence when it can't be had."""
    host = settings.host.strip("[]")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.getaddrinfo(host, settings.port, family)
    except OSError:
        raise BadInput(f"--host {settings.host} is no address of this machine") from None
    try:
        return socket.create_server((host, settings.port), family=family, backlog=256)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            text = f"port {settings.port} is in use; choose another with --port, or end what uses it"
        elif error.errno in (errno.EACCES, errno.EPERM):
            text = f"port {settings.port} needs more rights; choose one above 1023 with --port"
        elif error.errno == errno.EADDRNOTAVAIL:
            text = f"--host {settings.host} is no address of this machine"
        else:
            text = f"can't listen on {settings.host}:{settings.port}: {error.strerror or error}"
        raise BadInput(text) from None


class Announcing(uvicorn.Server):
    """A server that calls back once it answers."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self.ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            self.ready()


def serve(settings: Settings, *, page_path: str | None = None, say: Callable[[str], None]) -> None:
    """Serves the dashboard until Ctrl-C; live runs save a checkpoint then.

    page_path: the page to open, such as `/replay?run=…`; None starts settings.scenario when no run is open and opens
    it. say: prints a line to the person. Raises BadInput before anything is served.
    """
    if int(os.environ.get("WEB_CONCURRENCY") or 1) != 1:
        raise BadInput("the dashboard runs in one web process; unset WEB_CONCURRENCY")
    listening = bind(settings)
    try:
        app = create_app(settings)
        manager: RunManager = app.wattlane_manager
        path = page_path
        if path is None:
            path = "/operate"
            if settings.scenario and not manager.live():
                run_id = manager.start(settings.scenario, from_file=True)
                path = f"/operate?run={run_id}"
                threading.Thread(target=_report_start, args=(manager, run_id, say), daemon=True).start()
        separator = "&" if "?" in path else "?"
        secret = f"{separator}token={settings.token}" if settings.token else ""
        address = f"{settings.address}{path}{secret}"

        def ready() -> None:
            say(f"Wattlane is at {address}")
            say(f"Runs are kept in {settings.runs}. Ctrl-C ends the dashboard; live runs can be resumed.")
            if settings.open_browser:
                threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

        config = uvicorn.Config(
            app.server,
            log_level="warning",
            access_log=False,
            server_header=False,
            ws_max_size=SOCKET_LIMIT,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=GRACE_S,
            workers=1,
        )
        if threading.current_thread() is threading.main_thread():
            # uvicorn hands the signal on after its own shutdown; the default would skip saving the runs.
            signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
        try:
            Announcing(config, ready).run(sockets=[listening])
        finally:
            if manager.live():
                say("Saving the live runs …")
            manager.close()
    finally:
        listening.close()


def _report_start(manager: RunManager, run_id: str, say: Callable[[str], None]) -> None:
    """Says what takes long until the first frame is there."""
    told = ""
    woken = threading.Event()
    worker = manager.worker(run_id)
    if worker is None:
        return
    stop = worker.listen(woken.set)
    while worker.alive and not worker.frame:
        phase = str(worker.status.get("phase", ""))
        if phase.startswith("compiling") and phase != told:
            say(f"{phase[:1].upper()}{phase[1:]}: this takes up to a minute …")
            told = phase
        woken.wait(0.5)
        woken.clear()
    stop()
    if worker.frame and told:
        say("Kernels are compiled.")
    elif not worker.frame and (why := worker.obituary()):
        say(f"The run did not start: {why}")
