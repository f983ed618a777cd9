"""The dashboard's routes over a recorded run: what they answer, and what they refuse in a sentence."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest

from app.api import Wanted, read_wish
from app.live import decode_frame

SOCKET = "ws://127.0.0.1:8050/live/"


def test_health(client: Any) -> None:
    answer = client.get("/healthz")
    assert answer.status_code == 200
    assert answer.json()["status"] == "ok"


def test_pages_carry_a_policy_and_load_nothing_from_elsewhere(client: Any) -> None:
    for path in ("/", "/operate", "/replay"):
        answer = client.get(path)
        assert answer.status_code == 200
        policy = answer.headers["content-security-policy"]
        assert "'sha256-" in policy
        assert "'unsafe-eval'" not in policy
        assert "http://" not in answer.text.replace("http://127.0.0.1:8050", "")
        assert "https://" not in answer.text


def test_no_api_browser_no_debugger_no_mcp(client: Any) -> None:
    for path in ("/docs", "/openapi.json", "/redoc", "/_mcp"):
        assert "react-entry-point" in client.get(path).text  # only the page's own "not found"
    assert client.app.debug is False


def test_runs_are_listed_and_looked_into(client: Any, run_id: str) -> None:
    own = [run for run in client.get("/api/runs").json() if not run["demo"]]
    assert [run["run_id"] for run in own] == [run_id]
    assert own[0]["status"] == "finished"
    status = client.get(f"/api/runs/{run_id}").json()
    assert (status["alive"], status["resumable"], status["ticks"]) == (False, False, 240)


def test_scenarios_and_their_parameters(client: Any) -> None:
    answer = client.get("/api/scenarios").json()
    assert {"soochow2022", "soochow2022-continuous", "warehouse-large"} <= set(answer["scenarios"])
    assert any(parameter["key"] == "fleet.count" for parameter in answer["parameters"])


def test_a_replayed_frame_shows_what_the_log_says(client: Any, run_id: str) -> None:
    floor = client.get(f"/api/runs/{run_id}/floor").json()
    frame = decode_frame(client.get(f"/api/runs/{run_id}/frame?t=100.25").content)
    assert frame.replay
    assert (frame.tick, frame.time_s) == (100, 100.25)
    fleet = client.get(f"/api/runs/{run_id}/view?t=100.25&parts=fleet").json()["fleet"]
    assert len(fleet) == len(frame.vehicles) == 8
    width = floor["width"] * floor["cell_m"]
    x = frame.vehicles["x"].astype(float) / 65535 * width
    np.testing.assert_allclose(x, [vehicle["x"] for vehicle in fleet], atol=width / 65535 + 1e-3)
    end = decode_frame(client.get(f"/api/runs/{run_id}/frame").content)
    assert end.tick == 240


def test_views_routes_and_heat(client: Any, run_id: str) -> None:
    view = client.get(f"/api/runs/{run_id}/view?t=60").json()
    assert set(view) == {"time_s", "t_end_s", "fleet", "orders", "chargers", "events", "kpis"}
    assert (view["time_s"], view["t_end_s"]) == (60.0, 240.0)
    assert isinstance(client.get(f"/api/runs/{run_id}/routes?t=60").json(), list)
    places = len(client.get(f"/api/runs/{run_id}/floor").json()["places"])
    for kind in ("occupancy", "waiting", "energy", "expected"):
        assert len(client.get(f"/api/runs/{run_id}/heat?kind={kind}").json()["values"]) == places
    arcs = client.get(f"/api/runs/{run_id}/arcs?t0=60&t1=120").json()
    assert {name: len(values) for name, values in arcs.items()} == dict.fromkeys(
        ("expected_s", "occupancy", "passages"), places
    )


@pytest.mark.parametrize(
    ("path", "word"),
    [
        ("frame?t=-1", "t:"),
        ("frame?t=nan", "t:"),
        ("frame?t=soon", "t:"),
        ("heat?kind=love", "heat map"),
        ("view?parts=fleet,secrets", "secrets"),
        ("download/exe", "download"),
    ],
)
def test_bad_questions_are_refused_in_a_sentence(client: Any, run_id: str, path: str, word: str) -> None:
    answer = client.get(f"/api/runs/{run_id}/{path}")
    assert answer.status_code == 400
    assert word in answer.json()["error"]


TRAVERSALS = (
    "..",
    "../secret",
    "..%2f..%2fetc",
    "%2e%2e",
    "a/../../b",
    ".hidden",
    "a..b",
    "a b",
    "x" * 300,
    "\x00",
    "–",
)


@pytest.mark.parametrize("name", ["unknown-run", *TRAVERSALS])
@pytest.mark.parametrize(
    "path", ["/api/runs/{}/frame", "/api/runs/{}/download/rrd", "/recordings/{}.rrd", "/api/runs/{}"]
)
def test_unknown_and_crooked_run_ids_are_refused(client: Any, name: str, path: str) -> None:
    answer = client.get(path.format(quote(name, safe="/%")))
    if "react-entry-point" in answer.text:
        return  # the address was normalised to a page's, which shows nothing of the disk
    assert answer.status_code in (400, 404, 405)
    assert "error" in answer.json()


@pytest.mark.parametrize("name", [*TRAVERSALS, "/etc/passwd", "..\\..\\x"])
def test_the_manager_takes_no_crooked_id(client: Any, name: str) -> None:
    from app.runs import NoSuchRun, manager

    for act in (manager().folder, manager().status, manager().delete, manager().view):
        with pytest.raises(NoSuchRun):
            act(name)


def test_a_link_out_of_the_folder_is_no_run(client: Any, recorded: Path, run_id: str, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    shutil.copytree(recorded / "runs" / run_id, outside)
    link = recorded / "runs" / "a-link"
    link.symlink_to(outside)
    try:
        assert client.get("/api/runs/a-link").status_code == 404
    finally:
        link.unlink()


@pytest.mark.parametrize(
    ("body", "word"),
    [
        (b"", "request"),
        (b"{", "JSON"),
        (b"[1, 2]", "dictionary"),
        (b"\xff\xfe", "error"),
        (b'{"scenario": 3}', "scenario: a text"),
        (b'{"scenario": "soochow2021"}', "did you mean 'soochow2022'"),
        (b'{"scenario": "/etc/passwd"}', "unknown scenario"),
        (b'{"scenario": "../assets/scenarios/soochow2022.toml"}', "unknown scenario"),
        (b'{"scenario": "soochow2022", "seed": 1.5}', "seed"),
        (b'{"scenario": "soochow2022", "sede": 1}', "sede"),
        (b'{"scenario": "soochow2022", "planner": "priority"}', "prioritized"),
        (b'{"scenario": "soochow2022", "overrides": {"fleet.cuont": 3}}', "count"),
        (b'{"scenario": "soochow2022", "overrides": {"fleet.count": 0}}', "fleet.count"),
        (b'{"scenario": "soochow2022", "speed": 1000}', "speed"),
    ],
)
def test_a_start_that_makes_no_sense_starts_nothing(client: Any, body: bytes, word: str) -> None:
    answer = client.post("/api/runs", content=body, headers={"content-type": "application/json"})
    assert answer.status_code == 400
    assert word.lower() in json.dumps(answer.json(), ensure_ascii=False).lower()
    assert client.get("/healthz").json()["live_runs"] == 0
    assert len([run for run in client.get("/api/runs").json() if not run["demo"]]) == 1


def test_a_recorded_run_takes_no_commands(client: Any, run_id: str) -> None:
    answer = client.post(f"/api/runs/{run_id}/command", json={"do": "pause", "vehicle": 1})
    assert answer.status_code == 409
    assert "not running" in answer.json()["error"]
    assert client.post(f"/api/runs/{run_id}/command", json={"vehicle": 1}).status_code == 400
    assert client.post(f"/api/runs/{run_id}/control", json={"op": "explode"}).status_code == 400
    assert client.post(f"/api/runs/{run_id}/control", json={"op": "resume"}).status_code == 409
    assert client.post(f"/api/runs/{run_id}/control", json={"op": "step", "ticks": 0}).status_code == 400


@pytest.mark.parametrize(
    ("fork", "word"),
    [
        ({}, "tick"),
        ({"tick": -1}, "between 0"),
        ({"tick": 241}, "between 0"),
        ({"tick": 10, "overrides": {"fleet.count": 3}}, "can't change"),
        ({"tick": 10, "planner": "none such"}, "unknown planner"),
    ],
)
def test_a_fork_that_makes_no_sense_starts_nothing(client: Any, run_id: str, fork: dict[str, Any], word: str) -> None:
    answer = client.post(f"/api/runs/{run_id}/fork", json=fork)
    assert answer.status_code == 400
    assert word in answer.json()["error"]


def test_runs_can_be_renamed(client: Any, run_id: str) -> None:
    assert client.patch(f"/api/runs/{run_id}", json={"name": "  morning shift "}).is_success
    assert client.get(f"/api/runs/{run_id}").json()["name"] == "morning shift"
    for name in ("x" * 200, "a\nb", "\x07"):
        assert client.patch(f"/api/runs/{run_id}", json={"name": name}).status_code == 400


def test_downloads_hold_every_table(client: Any, run_id: str) -> None:
    from engine.results.schema import TABLES

    for what in ("csv", "parquet"):
        answer = client.get(f"/api/runs/{run_id}/download/{what}")
        names = {Path(name).name for name in zipfile.ZipFile(io.BytesIO(answer.content)).namelist()}
        assert {f"{table}.{what}" for table in TABLES} | {"manifest.json", "scenario.toml"} == names
    recording = client.get(f"/recordings/{run_id}.rrd")
    assert recording.content[:4] == b"RRF2"
    assert client.get(f"/api/runs/{run_id}/download/rrd").content == recording.content


def test_an_upload_of_fifty_megabytes_is_refused_and_the_server_lives(client: Any) -> None:
    answer = client.post("/api/runs", content=b"0" * 50_000_000, headers={"content-type": "application/json"})
    assert answer.status_code == 413
    assert client.get("/healthz").status_code == 200


def test_callbacks_refuse_what_is_no_object(client: Any) -> None:
    for body in (b"{", b"[]", b"1"):
        answer = client.post("/_dash-update-component", content=body, headers={"content-type": "application/json"})
        assert answer.status_code == 400
    assert client.get("/healthz").status_code == 200


def callback(client: Any, output: str, **inputs: Any) -> dict[str, Any]:
    """What the server answers to the callback whose outputs contain a text, for inputs by `id__property`."""
    for known in client.get("/_dash-dependencies").json():
        if output in known["output"] and known["inputs"] and not known["clientside_function"]:
            break
    else:
        pytest.fail(f"no callback for {output}")
    names = [(i["id"], i["property"]) for i in known["inputs"]]
    listed = known["output"].strip(".").split("...")
    outputs = [dict(zip(("id", "property"), one.split("@")[0].rsplit(".", 1), strict=True)) for one in listed]
    body = {
        "output": known["output"],
        "outputs": outputs if known["output"].startswith("..") else outputs[0],
        "inputs": [{"id": i, "property": p, "value": inputs.get(f"{i.replace('-', '_')}__{p}")} for i, p in names],
        "changedPropIds": [f"{i}.{p}" for i, p in names],
        "state": [],
    }
    answer = client.post("/_dash-update-component", json=body)
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def tracebacks(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [str(record.exc_info[1]) for record in caplog.records if record.exc_info]


def test_a_mistake_in_a_callback_is_logged_and_said(
    client: Any, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    from app.pages import data, shell

    def broken(*_: Any) -> Any:
        raise ZeroDivisionError("a mistake")

    monkeypatch.setattr(data, "scenario_values", broken)
    told = callback(client, "start-keys", start_scenario__value="soochow2022")
    assert told["sideUpdate"]["notify"] == shell.failure()
    assert tracebacks(caplog) == ["a mistake"]
    caplog.clear()
    monkeypatch.setattr(shell, "content", broken)
    told = callback(client, "page.children", url__pathname="/runs", url__search="")
    assert shell.FAILURE in str(told["response"]["page"]["children"])
    assert "current" in str(told["response"]["nav"]["children"])
    assert tracebacks(caplog) == ["a mistake"]


def test_an_answer_that_cant_be_sent_is_logged_and_said(
    client: Any, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    from app.pages import shell

    monkeypatch.setattr(shell, "content", lambda *_: object())
    told = callback(client, "page.children", url__pathname="/runs", url__search="")
    assert told["sideUpdate"]["notify"] == shell.failure()
    assert len(tracebacks(caplog)) == 1


def test_the_start_form_asks_for_orders_only_where_there_are_some(client: Any) -> None:
    for name, orders in (("soochow2022-continuous", True), ("xu2025", False)):
        told = callback(client, "start-keys", start_scenario__value=name)["response"]
        assert told["start-rate"]["style"] == ({} if orders else {"display": "none"})
        keys = str(told["start-keys"]["children"])
        assert "fleet.count" in keys
        assert ("orders." in keys) is orders


def test_unknown_addresses_below_api_are_not_pages(client: Any) -> None:
    for path in ("/api/", "/api/nothing", "/api/runs/x/y/z"):
        assert client.get(path).status_code == 404


def test_rerun_files_are_those_of_the_viewer_only(client: Any) -> None:
    for name in ("..%2fhealthz", "passwd", "re_viewer_bg.wasm.gz", "index.htm"):
        assert client.get(f"/rerun/{name}").status_code == 404


# Sockets


def next_of_kind(socket: Any, kind: str) -> Any:
    """The next frame, or the next text of a type."""
    while True:
        message = socket.receive()
        if "bytes" in message and message["bytes"] is not None:
            if kind == "frame":
                return decode_frame(message["bytes"])
            continue
        text = json.loads(message["text"])
        if text["type"] == kind:
            return text


def test_the_socket_answers_with_the_frame_asked_for(client: Any, run_id: str) -> None:
    with client.websocket_connect(SOCKET + run_id) as socket:
        assert next_of_kind(socket, "status")["status"] == "finished"
        for time_s in (10.0, 200.5, 3.0):
            socket.send_text(json.dumps({"t": time_s}))
            frame = next_of_kind(socket, "frame")
            assert (frame.time_s, frame.replay) == (time_s, True)


@pytest.mark.parametrize(
    "text",
    ["", "{", "null", "[]", "{}", '{"t": "soon"}', '{"t": -1}', '{"t": true}', '{"x": 1}', "[" * 4000, "x" * 9000],
)
def test_malformed_messages_are_answered_and_forgotten(client: Any, run_id: str, text: str) -> None:
    with client.websocket_connect(SOCKET + run_id) as socket:
        socket.send_text(text)
        assert "expected" in next_of_kind(socket, "error")["text"]
        socket.send_bytes(b"\x00\xff")
        assert "expected" in next_of_kind(socket, "error")["text"]
        socket.send_text('{"t": 5}')
        assert next_of_kind(socket, "frame").time_s == 5.0


def test_a_socket_to_no_run_says_so(client: Any) -> None:
    with client.websocket_connect(SOCKET + "unknown-run") as socket:
        assert "no run" in json.loads(socket.receive_text())["text"]


def test_only_the_last_wish_counts() -> None:
    wanted = Wanted()
    for time_s in (1, 2, 3):
        assert read_wish(json.dumps({"t": time_s}), wanted) == ""
    assert (wanted.time_s, wanted.fresh) == (3.0, True)
    assert read_wish('{"follow": false}', wanted) == ""
    assert wanted.follow is False
    assert "follow" in read_wish('{"follow": 1}', wanted)
