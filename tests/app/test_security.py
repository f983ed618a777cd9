"""The gate: Host, Origin, token, body limit and headers, for pages, routes and sockets alike."""

from __future__ import annotations

import json
from typing import Any

import pytest
from fastapi import FastAPI, Request, Response, WebSocket
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from app.security import Gate, allowed_hosts, host_allowed, page_csp, same_origin, token_matches
from app.settings import Settings

TOKEN = "a-good-token-0123"
LIVE = "ws://127.0.0.1:8050/live"


def dashboard(**values: Any) -> TestClient:
    """A small server behind the gate."""
    app = FastAPI()

    @app.get("/healthz")
    def health() -> dict[str, bool]:
        return {"ok": True}

    @app.get("/{path:path}")
    def page(path: str) -> Response:
        return Response(path, media_type="text/html", headers={"content-security-policy": "default-src 'self'"})

    @app.post("/{path:path}")
    async def post(path: str, request: Request) -> dict[str, int]:
        return {"got": len(await request.body())}

    @app.delete("/{path:path}")
    def delete(path: str) -> dict[str, bool]:
        return {"deleted": True}

    @app.websocket("/live")
    async def live(socket: WebSocket) -> None:
        await socket.accept()
        await socket.send_text("hello")
        await socket.close()

    app.add_middleware(Gate, settings=Settings(**{"data": "/nowhere", "body_limit": 1000, **values}))
    return TestClient(app, base_url="http://127.0.0.1:8050", follow_redirects=False)


# Host


@pytest.mark.parametrize("host", ["127.0.0.1:8050", "localhost:8050", "localhost", "[::1]:8050", "LOCALHOST:9"])
def test_own_names_are_known(host: str) -> None:
    assert dashboard().get("/", headers={"host": host}).status_code == 200


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "", "a b", "[::1", "localhost.evil"])
def test_other_names_are_refused_in_a_sentence(host: str) -> None:
    answer = dashboard().get("/", headers={"host": host})
    assert answer.status_code == 400
    assert "isn't known as" in answer.json()["error"]


def test_a_proxys_name_can_be_allowed() -> None:
    client = dashboard(allowed_hosts=("wattlane.example",))
    assert client.get("/", headers={"host": "wattlane.example"}).status_code == 200


def test_when_everyone_is_let_in_the_token_guards() -> None:
    everywhere = Settings(host="0.0.0.0", token=TOKEN, data="/nowhere")  # type: ignore[arg-type]
    assert host_allowed("whatever.example", allowed_hosts(everywhere))
    client = dashboard(host="0.0.0.0", token=TOKEN)
    assert client.get("/", headers={"host": "192.168.0.9:8050"}).status_code == 401


# Origin


@pytest.mark.parametrize(
    ("origin", "own"),
    [
        (None, True),
        ("http://127.0.0.1:8050", True),
        ("HTTP://127.0.0.1:8050".lower(), True),
        ("http://127.0.0.1:3000", False),
        ("http://evil.example", False),
        ("null", False),
        ("file://", False),
    ],
)
def test_same_origin(origin: str | None, own: bool) -> None:
    assert same_origin(origin, "127.0.0.1:8050") is own


@pytest.mark.parametrize("method", ["POST", "DELETE", "PATCH", "PUT"])
def test_another_site_cannot_change_anything(method: str) -> None:
    answer = dashboard().request(method, "/x", headers={"origin": "http://evil.example"})
    assert answer.status_code == 403
    assert "another site" in answer.json()["error"]


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_browser_that_says_cross_site_is_believed(site: str) -> None:
    assert dashboard().post("/x", headers={"sec-fetch-site": site}).status_code == 403


def test_own_pages_and_programs_can() -> None:
    client = dashboard()
    assert client.post("/x", headers={"origin": "http://127.0.0.1:8050", "sec-fetch-site": "same-origin"}).is_success
    assert client.post("/x").is_success
    assert client.get("/x", headers={"origin": "http://evil.example"}).is_success


def test_sockets_pass_the_same_gate() -> None:
    client = dashboard()
    with client.websocket_connect(LIVE, headers={"origin": "http://127.0.0.1:8050"}) as socket:
        assert socket.receive_text() == "hello"
    for headers in ({"origin": "http://evil.example"}, {"host": "evil.example"}):
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE, headers=headers) as socket:
            socket.receive_text()


# Token


def test_without_the_token_nothing_but_health_answers() -> None:
    client = dashboard(token=TOKEN)
    assert client.get("/healthz").status_code == 200
    refused = client.get("/")
    assert refused.status_code == 401
    assert "token" in refused.json()["error"]
    assert refused.headers["www-authenticate"] == "Bearer"
    assert client.get("/", headers={"authorization": "Bearer wrong-token"}).status_code == 401
    assert client.get("/?token=").status_code == 401
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE) as socket:
        socket.receive_text()


def test_the_token_is_taken_from_header_query_and_cookie() -> None:
    for headers in ({"authorization": f"Bearer {TOKEN}"}, {"cookie": f"wattlane_token_8050={TOKEN}"}):
        assert dashboard(token=TOKEN).get("/", headers=headers).status_code == 200
        with dashboard(token=TOKEN).websocket_connect(LIVE, headers=headers) as socket:
            assert socket.receive_text() == "hello"
    assert dashboard(token=TOKEN).get(f"/?token={TOKEN}").status_code == 200


def test_a_page_opened_with_the_token_keeps_it_out_of_the_address() -> None:
    client = dashboard(token=TOKEN)
    answer = client.get(f"/operate?run=a%20b&token={TOKEN}", headers={"accept": "text/html"})
    assert answer.status_code == 303
    assert answer.headers["location"] == "/operate?run=a+b"
    cookie = answer.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert client.get("/operate", headers={"accept": "text/html"}).status_code == 200


def test_the_redirect_stays_on_this_host() -> None:
    answer = dashboard(token=TOKEN).get(f"//evil.example/x?token={TOKEN}", headers={"accept": "text/html"})
    assert answer.headers.get("location", "/").startswith("/")
    assert not answer.headers.get("location", "/").startswith("//")


def test_tokens_are_compared_whole() -> None:
    assert token_matches(TOKEN, TOKEN)
    for wrong in (None, "", TOKEN[:-1], TOKEN + "x", TOKEN.upper()):
        assert not token_matches(wrong, TOKEN)


# Size


def test_a_body_too_large_is_refused_and_the_server_goes_on() -> None:
    client = dashboard(body_limit=8 * 2**20)
    answer = client.post("/x", content=b"0" * 50_000_000)
    assert answer.status_code == 413
    assert "8 MB" in answer.json()["error"]
    assert client.post("/x", content=b"0" * 1000).json() == {"got": 1000}


def test_a_body_of_unknown_length_is_counted() -> None:
    client = dashboard()
    assert client.post("/x", content=iter([b"0" * 400] * 2)).json() == {"got": 800}
    assert client.post("/x", content=iter([b"0" * 400] * 3)).status_code == 413
    assert client.post("/x", content=b"1", headers={"content-length": "many"}).status_code == 413


# Headers


def test_every_answer_carries_the_headers() -> None:
    client = dashboard(token=TOKEN)
    for path in ("/healthz", "/"):
        headers = client.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["x-frame-options"] == "SAMEORIGIN"
        assert "content-security-policy" in headers
    own = client.get("/", headers={"authorization": f"Bearer {TOKEN}"}).headers
    assert own["content-security-policy"] == "default-src 'self'"


def test_a_pages_policy_allows_its_own_scripts_and_no_others() -> None:
    html = "<script>one()</script><script src='/a.js'></script><script type='application/json'>{}</script>"
    policy = page_csp(html, "127.0.0.1:8050")
    assert policy.count("'sha256-") == 1
    assert "'unsafe-inline'" not in policy.split("script-src")[1].split(";")[0]
    assert "'unsafe-eval'" not in policy
    assert "connect-src 'self' ws://127.0.0.1:8050 wss://127.0.0.1:8050" in policy
    assert "evil" not in page_csp(html, "x; script-src evil")


def test_refusals_are_json() -> None:
    body = dashboard().get("/", headers={"host": "evil.example"}).content
    assert set(json.loads(body)) == {"error"}
