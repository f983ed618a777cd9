"""The dashboard's HTTP and WebSocket routes beside Dash's own: runs, frames, commands, downloads, the Rerun viewer.

Times in addresses are simulated seconds. Every refusal is a JSON object {"error": sentence}.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import Body, FastAPI, Query, Request, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, Response
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.websockets import WebSocketDisconnect

from app.jsonable import plain
from app.library import ImportOptions, Library, NoSuchScenario, Upload
from app.live import REPLAY, encode_frame
from app.runs import NoSuchRun, RunManager
from app.security import VIEWER_CSP
from engine.errors import BadInput, WattlaneError

if TYPE_CHECKING:
    from engine.results.view import RunView

log = logging.getLogger(__name__)

PARTS = ("fleet", "orders", "chargers", "events", "kpis")
STATUS_S = 0.5
SOCKET_MESSAGE_LIMIT = 4096
NO_STORE = {"cache-control": "no-store"}
DOWNLOADS = ("rrd", "csv", "parquet")
IMPORT_KEYS = ("agents", "planner", "objective", "seed")

Seconds = Annotated[float | None, Query(ge=0, le=1e9, allow_inf_nan=False)]
Json = Annotated[dict[str, Any], Body()]


def answer(value: Any, status: int = 200) -> Response:
    body = json.dumps(plain(value), ensure_ascii=False, allow_nan=False).encode()
    return Response(body, status, NO_STORE, "application/json")


def status_of(error: WattlaneError) -> int:
    if isinstance(error, NoSuchRun | NoSuchScenario):
        return 404
    return 400 if isinstance(error, BadInput) else 409


def add_error_answers(server: FastAPI) -> None:
    """Every error on these routes becomes one sentence; the server goes on."""

    @server.exception_handler(WattlaneError)
    async def refused(_: Request, error: WattlaneError) -> Response:
        return answer({"error": str(error)}, status_of(error))

    @server.exception_handler(OSError)
    async def disk(_: Request, error: OSError) -> Response:
        return answer({"error": f"the disk refused: {error.strerror or error}"}, 507)

    @server.exception_handler(RequestValidationError)
    async def malformed(_: Request, error: RequestValidationError) -> Response:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first.get("loc", ()) if part not in ("body", "query", "path"))
        return answer({"error": f"{where or 'the request'}: {first.get('msg', 'malformed')}"}, 400)

    @server.exception_handler(HTTPException)
    async def http(_: Request, error: HTTPException) -> Response:
        return answer({"error": str(error.detail)}, error.status_code)


def ticks_of(view: RunView, tick_s: float, time_s: float | None) -> float:
    """Seconds to ticks within what the run covers; None is its end."""
    end = float(view.t_end)
    return end if time_s is None else min(max(0.0, time_s / tick_s), end)


def replay_frame(manager: RunManager, run_id: str, time_s: float | None, sequence: int = 0) -> bytes:
    """The frame of a recorded instant, from the log."""
    manifest = manager.manifest(run_id)
    tick_s = float(manifest["tick_s"])

    def ask(view: RunView) -> bytes:
        time_ticks = ticks_of(view, tick_s, time_s)
        width_m, height_m = view.world.size_m
        return encode_frame(
            view.poses(time_ticks),
            width_m=width_m,
            height_m=height_m,
            time_s=time_ticks * tick_s,
            tick=int(time_ticks),
            sequence=sequence,
            flags=REPLAY,
        )

    return manager.read(run_id, ask)


def view_parts(manager: RunManager, run_id: str, time_s: float | None, parts: list[str]) -> dict[str, Any]:
    """The parts of a run's view at an instant, ready for JSON."""
    tick_s = float(manager.manifest(run_id)["tick_s"])

    def ask(view: RunView) -> dict[str, Any]:
        at = ticks_of(view, tick_s, time_s)
        read: dict[str, Callable[[], Any]] = {
            "fleet": lambda: view.fleet(at),
            "orders": lambda: view.orders(at),
            "chargers": lambda: view.chargers(at),
            "events": lambda: view.events(0, at + 1),
            "kpis": lambda: view.kpis(at),
        }
        return {"time_s": at * tick_s, "t_end_s": view.t_end * tick_s, **{part: read[part]() for part in parts}}

    return manager.read(run_id, ask)


def add_run_routes(server: FastAPI, manager: RunManager) -> None:
    """Runs: list, start, command, fork, rename, delete."""

    @server.get("/healthz")
    def healthz() -> Response:
        return answer({"status": "ok", "live_runs": len(manager.live())})

    @server.get("/api/runs")
    def runs() -> Response:
        return answer(manager.list())

    @server.post("/api/runs")
    def start(asked: Json) -> Response:
        known = {"scenario", "seed", "planner", "objective", "overrides", "name", "speed", "paused"}
        check_keys(asked, known)
        run_id = manager.start(
            text_in(asked, "scenario") or "",
            seed=integer_in(asked, "seed"),
            planner=text_in(asked, "planner"),
            objective=text_in(asked, "objective"),
            overrides=object_in(asked, "overrides"),
            name=text_in(asked, "name") or "",
            speed=asked.get("speed", 1.0),
            paused=asked.get("paused") is True,
        )
        return answer({"run_id": run_id}, 201)

    @server.get("/api/runs/{run_id}")
    def status(run_id: str) -> Response:
        return answer(manager.status(run_id))

    @server.post("/api/runs/{run_id}/command")
    def command(run_id: str, asked: Json) -> Response:
        return answer(manager.command(run_id, asked))

    @server.post("/api/runs/{run_id}/control")
    def control(run_id: str, asked: Json) -> Response:
        values = {key: value for key, value in asked.items() if key in ("ticks", "factor", "speed")}
        return answer(manager.control(run_id, str(asked.get("op")), **values))

    @server.post("/api/runs/{run_id}/fork")
    def fork(run_id: str, asked: Json) -> Response:
        check_keys(asked, {"tick", "planner", "seed", "overrides", "name"})
        tick = integer_in(asked, "tick")
        if tick is None:
            raise BadInput("a tick was expected: the one from which the fork goes on")
        made = manager.fork(
            run_id,
            tick,
            planner=text_in(asked, "planner"),
            seed=integer_in(asked, "seed"),
            overrides=object_in(asked, "overrides"),
            name=text_in(asked, "name") or "",
        )
        return answer({"run_id": made}, 201)

    @server.patch("/api/runs/{run_id}")
    def rename(run_id: str, asked: Json) -> Response:
        check_keys(asked, {"name"})
        manager.rename(run_id, text_in(asked, "name") or "")
        return answer({"run_id": run_id})

    @server.delete("/api/runs/{run_id}")
    def delete(run_id: str) -> Response:
        manager.delete(run_id)
        return answer({"run_id": run_id})


def add_moment_routes(server: FastAPI, manager: RunManager) -> None:
    """What a run looks like at an instant: its floor, a frame, routes, power, what the panels show."""

    @server.get("/api/runs/{run_id}/floor")
    def floor(run_id: str) -> Response:
        return answer(manager.read(run_id, lambda view: view.world.floor_json()))

    @server.get("/api/runs/{run_id}/frame")
    def frame(run_id: str, t: Seconds = None) -> Response:
        manager.folder(run_id)
        worker = manager.worker(run_id)
        if t is None and worker is not None:
            if not worker.frame:
                return answer({"error": f"the run is starting: {worker.status.get('phase', '')}"}, 503)
            data = worker.frame
        else:
            data = replay_frame(manager, run_id, t)
        return Response(data, 200, NO_STORE, "application/octet-stream")

    @server.get("/api/runs/{run_id}/routes")
    def routes(run_id: str, t: Seconds = None) -> Response:
        tick_s = float(manager.manifest(run_id)["tick_s"])
        return answer(manager.read(run_id, lambda view: view.routes(ticks_of(view, tick_s, t))))

    @server.get("/api/runs/{run_id}/power")
    def power(run_id: str, t: Seconds = None) -> Response:
        tick_s = float(manager.manifest(run_id)["tick_s"])
        watts = manager.read(run_id, lambda view: view.power(ticks_of(view, tick_s, t)))
        return answer({"values": [None if math.isnan(value) else round(value, 1) for value in watts.tolist()]})

    @server.get("/api/runs/{run_id}/view")
    def view(run_id: str, t: Seconds = None, parts: str = "fleet,orders,chargers,events,kpis") -> Response:
        wanted = [part for part in parts.split(",") if part]
        if unknown := [part for part in wanted if part not in PARTS]:
            raise BadInput(f"parts of {', '.join(PARTS)} were expected; got {unknown[0][:40]!r}")
        return answer(view_parts(manager, run_id, t, wanted))


def add_span_routes(server: FastAPI, manager: RunManager) -> None:
    """What a run has come to over a time: heat maps, arcs, the ground seen so far."""

    @server.get("/api/runs/{run_id}/heat")
    def heat(run_id: str, kind: str = "occupancy", t0: Seconds = None, t1: Seconds = None) -> Response:
        from engine.results.view import HEATS

        if kind not in HEATS:
            raise BadInput(f"a heat map of {', '.join(HEATS)} was expected; got {kind[:40]!r}")
        tick_s = float(manager.manifest(run_id)["tick_s"])

        def ask(view: RunView) -> Any:
            return view.heat(kind, ticks_of(view, tick_s, t0 or 0.0), ticks_of(view, tick_s, t1))

        return answer({"kind": kind, "values": manager.read(run_id, ask)})

    @server.get("/api/runs/{run_id}/arcs")
    def arcs(run_id: str, t0: Seconds = None, t1: Seconds = None) -> Response:
        tick_s = float(manager.manifest(run_id)["tick_s"])

        def ask(view: RunView) -> Any:
            return view.arcs(ticks_of(view, tick_s, t0 or 0.0), ticks_of(view, tick_s, t1))

        return answer(manager.read(run_id, ask))

    @server.get("/api/runs/{run_id}/ground")
    def ground(run_id: str, t: Seconds = None, since: int = 0, way: int = -2, frontier: bool = False) -> Response:
        from engine.results.ground import ground_of

        tick_s = float(manager.manifest(run_id)["tick_s"])

        def ask(view: RunView) -> Any:
            known = ground_of(view)
            if known is None:
                raise BadInput(f"run {run_id} is on a floor; a run on terrain was expected")
            return known.told(ticks_of(view, tick_s, t), since, way, frontier)

        return answer(manager.read(run_id, ask))


def add_scenario_routes(server: FastAPI, library: Library) -> None:
    """Scenarios: list, look at, import, rename, delete, download."""

    @server.get("/api/scenarios")
    def scenarios() -> Response:
        import engine.scenario

        imported = library.imported()
        return answer({"scenarios": library.titles(), "imported": imported, "parameters": engine.scenario.parameters()})

    @server.post("/api/scenarios")
    def add(asked: Json) -> Response:
        check_keys(asked, {"files", "name", *IMPORT_KEYS})
        return answer({"name": library.add(files_in(asked), text_in(asked, "name"), import_options_in(asked))}, 201)

    @server.post("/api/scenarios/preview")
    def preview(asked: Json) -> Response:
        check_keys(asked, {"files", *IMPORT_KEYS})
        return answer(library.look(files_in(asked), import_options_in(asked)))

    @server.get("/api/scenarios/{name}/floor")
    def floor(name: str) -> Response:
        return answer(library.floor(name))

    @server.get("/api/scenarios/{name}/thumb")
    def thumb(name: str) -> Response:
        return answer(library.thumb(name))

    @server.get("/api/scenarios/{name}/checks")
    def checks(name: str) -> Response:
        return answer({"findings": library.findings(name)})

    @server.get("/api/scenarios/{name}/files/{file}")
    def download(name: str, file: str) -> Response:
        found = library.files(name).get(file)
        if found is None:
            raise HTTPException(404, f"scenario {name} has no file {file[:80]!r}")
        return FileResponse(found, filename=file, media_type="text/plain; charset=utf-8", headers=NO_STORE)

    @server.patch("/api/scenarios/{name}")
    def rename(name: str, asked: Json) -> Response:
        check_keys(asked, {"name"})
        return answer({"name": library.rename(name, text_in(asked, "name") or "")})

    @server.delete("/api/scenarios/{name}")
    def delete(name: str) -> Response:
        library.delete(name)
        return answer({"name": name})


def files_in(asked: dict[str, Any]) -> list[Upload]:
    """The files of an import: [{name, text}, …]."""
    files = asked.get("files")
    if not isinstance(files, list) or not all(isinstance(file, dict) for file in files):
        raise BadInput('files: a list such as [{"name": "my-floor.toml", "text": "…"}] was expected')
    return [Upload(text_in(file, "name") or "", text_in(file, "text") or "") for file in files]


def import_options_in(asked: dict[str, Any]) -> ImportOptions:
    seed = integer_in(asked, "seed")
    if seed is not None and seed < 0:
        raise BadInput(f"seed: zero or more was expected; got {seed}")
    return ImportOptions(
        agents=integer_in(asked, "agents"),
        planner=text_in(asked, "planner"),
        objective=text_in(asked, "objective"),
        seed=1 if seed is None else seed,
    )


def check_keys(asked: dict[str, Any], known: set[str]) -> None:
    if unknown := sorted(set(asked) - known):
        raise BadInput(f"unknown key {unknown[0][:40]!r}; known: {', '.join(sorted(known))}")


def text_in(asked: dict[str, Any], key: str) -> str | None:
    value = asked.get(key)
    if value is None or isinstance(value, str):
        return value
    raise BadInput(f"{key}: a text was expected; got {json.dumps(value)[:40]}")


def integer_in(asked: dict[str, Any], key: str) -> int | None:
    value = asked.get(key)
    if value is None or (isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**63):
        return value
    raise BadInput(f"{key}: a whole number was expected; got {json.dumps(value)[:40]}")


def object_in(asked: dict[str, Any], key: str) -> dict[str, Any]:
    value = asked.get(key)
    if value is None:
        return {}
    if isinstance(value, dict):
        return value
    raise BadInput(f"{key}: an object was expected; got {json.dumps(value)[:40]}")


def add_file_routes(server: FastAPI, manager: RunManager, viewer_cache: Path) -> None:
    """Downloads, recordings, and the embedded Rerun viewer."""

    @server.get("/api/runs/{run_id}/download/{what}")
    def download(run_id: str, what: str) -> Response:
        if what not in DOWNLOADS:
            raise BadInput(f"a download of {', '.join(DOWNLOADS)} was expected; got {what[:40]!r}")
        if what == "rrd":
            return FileResponse(recording(manager, run_id), filename=f"{run_id}.rrd", headers=NO_STORE)
        from app.export import zipped

        file = zipped(manager.folder(run_id), what)
        cleanup = BackgroundTask(lambda: file.unlink(missing_ok=True))
        return FileResponse(file, filename=f"{run_id}-{what}.zip", headers=NO_STORE, background=cleanup)

    @server.get("/recordings/{name:path}")
    def recorded(name: str) -> Response:
        if not name.endswith(".rrd"):
            raise HTTPException(404, "recordings are named <run id>.rrd")
        return FileResponse(
            recording(manager, name.removesuffix(".rrd")), media_type="application/octet-stream", headers=NO_STORE
        )

    @server.get("/rerun")
    def viewer_page() -> Response:
        return viewer_file("index.html", False)

    @server.get("/rerun/{name:path}")
    def viewer(name: str, request: Request) -> Response:
        return viewer_file(name or "index.html", "gzip" in request.headers.get("accept-encoding", ""))

    def viewer_file(name: str, packed: bool) -> Response:
        from engine.replay.viewer import FILES, viewer_files

        if name not in FILES:
            raise HTTPException(404, "the viewer has no such file")
        file = viewer_files(viewer_cache) / name
        headers = {"content-security-policy": VIEWER_CSP, "cache-control": "no-cache"}
        kind = {"html": "text/html", "js": "text/javascript", "wasm": "application/wasm"}[name.rpartition(".")[2]]
        zipped = file.with_name(f"{name}.gz")
        if packed and zipped.is_file():
            return FileResponse(zipped, media_type=kind, headers={**headers, "content-encoding": "gzip"})
        return FileResponse(file, media_type=kind, headers=headers)


def add_compare_routes(server: FastAPI, manager: RunManager) -> None:
    """Runs beside each other: what each has come to at a time, where they part, and one recording of all."""
    from app.comparing import Comparisons

    beside = Comparisons(manager)

    @server.get("/api/compare")
    def compare(runs: str = "", t: Seconds = None) -> Response:
        return answer(beside.told(beside.checked(run_ids_in(runs)), t))

    @server.get("/api/compare/rrd")
    def compared(runs: str = "") -> Response:
        file = beside.recording(beside.checked(run_ids_in(runs)))
        cleanup = BackgroundTask(lambda: file.unlink(missing_ok=True))
        return FileResponse(file, filename="compare.rrd", headers=NO_STORE, background=cleanup)


def run_ids_in(text: str) -> list[str]:
    """Run ids separated by commas."""
    return [word for word in text.split(",") if word]


def recording(manager: RunManager, run_id: str) -> Path:
    """The run's `.rrd`, made from its log when it has none or its writer was killed."""
    from app.runner import rebuild_recording, scenario_of, world_of
    from engine.replay.sink import is_finished

    folder = manager.folder(run_id)
    file = folder / "run.rrd"
    if not file.is_file() or not (manager.worker_alive(run_id) or is_finished(file)):
        scenario = scenario_of(folder)
        rebuild_recording(folder, scenario, world_of(scenario))
    return file


class Wanted:
    """What a socket's client asked for last."""

    def __init__(self) -> None:
        self.time_s: float | None = None
        self.fresh = False  # asked for and not answered yet
        self.follow = True
        self.gone = False


def add_socket(server: FastAPI, manager: RunManager) -> None:
    """/live/{run}: live frames as they come, replay frames as they are asked for; always the newest, never a queue."""

    @server.websocket("/live/{run_id}")
    async def live(socket: WebSocket, run_id: str) -> None:
        await socket.accept()
        try:
            manager.folder(run_id)
        except WattlaneError as error:
            await socket.send_text(json.dumps({"type": "error", "text": str(error)}))
            await socket.close(4404)
            return
        wanted, wake = Wanted(), asyncio.Event()
        reader = asyncio.create_task(listen(socket, wanted, wake))
        try:
            await feed(socket, manager, run_id, wanted, wake)
        except (WebSocketDisconnect, RuntimeError) as error:
            log.debug("socket of %s closed: %s", run_id, error)
        finally:
            reader.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await reader


async def listen(socket: WebSocket, wanted: Wanted, wake: asyncio.Event) -> None:
    """Takes the client's wishes; a malformed one is answered with a sentence and forgotten."""
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            wanted.gone = True
            wake.set()
            return
        text = message.get("text")
        problem = read_wish(text, wanted)
        if problem:
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                await socket.send_text(json.dumps({"type": "error", "text": problem}))
        wake.set()


def read_wish(text: str | None, wanted: Wanted) -> str:
    """Takes {"t": seconds} or {"follow": true|false}; returns what was wrong with it, or an empty text."""
    expected = 'a message such as {"t": 120.5} or {"follow": true} was expected'
    if text is None or len(text) > SOCKET_MESSAGE_LIMIT:
        return expected
    try:
        wish = json.loads(text)
    except (ValueError, RecursionError):
        return f"{expected}; this is no JSON"
    if not isinstance(wish, dict) or not (wish.keys() & {"t", "follow"}):
        return expected
    if "follow" in wish:
        if not isinstance(wish["follow"], bool):
            return "follow: true or false was expected"
        wanted.follow = wish["follow"]
    if "t" in wish:
        time_s = wish["t"]
        if isinstance(time_s, bool) or not isinstance(time_s, int | float) or not 0 <= time_s <= 1e9:
            return "t: a number of seconds, zero or more, was expected"
        wanted.time_s, wanted.fresh = float(time_s), True
    return ""


async def feed(socket: WebSocket, manager: RunManager, run_id: str, wanted: Wanted, wake: asyncio.Event) -> None:
    """Sends until the client is gone. A slow client waits in `send`, and gets what is newest after it."""
    loop = asyncio.get_running_loop()
    last_frame, last_status, sequence = -1, 0.0, 0
    worker, stop = None, None

    def rouse() -> None:
        with contextlib.suppress(RuntimeError):  # the loop ends before the run does
            loop.call_soon_threadsafe(wake.set)

    try:
        while not wanted.gone:
            current = manager.worker(run_id)
            if current is not worker:
                if stop is not None:
                    stop()
                worker, last_frame, last_status = current, -1, 0.0
                stop = current.listen(rouse) if current is not None else None
            if worker is not None and wanted.follow and worker.frame and worker.frame_number != last_frame:
                last_frame = worker.frame_number
                await socket.send_bytes(worker.frame)
            if wanted.fresh:
                wanted.fresh, sequence = False, sequence + 1
                try:
                    frame = await run_in_threadpool(replay_frame, manager, run_id, wanted.time_s, sequence)
                except WattlaneError as error:
                    await socket.send_text(json.dumps({"type": "error", "text": str(error)}))
                else:
                    await socket.send_bytes(frame)
            if time.monotonic() - last_status >= STATUS_S:
                last_status = time.monotonic()
                try:
                    status = await run_in_threadpool(manager.status, run_id)
                except WattlaneError as error:
                    await socket.send_text(json.dumps({"type": "error", "text": str(error)}))
                    await socket.close(4404)
                    return
                await socket.send_text(json.dumps(plain({"type": "status", **status})))
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(wake.wait(), STATUS_S)
            wake.clear()
    finally:
        if stop is not None:
            stop()


def install(server: FastAPI, manager: RunManager, viewer_cache: Path) -> None:
    """Adds every route; what is unknown below /api answers 404 rather than a page."""
    add_error_answers(server)
    add_run_routes(server, manager)
    add_moment_routes(server, manager)
    add_span_routes(server, manager)
    add_compare_routes(server, manager)
    add_scenario_routes(server, manager.scenarios)
    add_file_routes(server, manager, viewer_cache)
    add_socket(server, manager)

    @server.api_route("/api/{rest:path}", methods=["GET", "POST", "PUT", "PATCH", "DELETE"])
    def unknown(rest: str) -> Response:
        return answer({"error": f"there is no /api/{rest[:80]}"}, 404)
