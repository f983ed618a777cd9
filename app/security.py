"""Who may talk to the dashboard, and what a page may load. Pure ASGI, so that sockets pass the same gate as pages."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import re
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.settings import Settings, is_loopback

COOKIE = "wattlane_token_{port}"
"""Named after the port, since browsers share cookies between the ports of a host."""
OPEN_PATHS = frozenset({"/healthz"})
UNSAFE_METHODS = frozenset({"POST", "PUT", "PATCH", "DELETE"})
DRAIN_LIMIT = 256 * 2**20
_INLINE_SCRIPT = re.compile(r"<script(?P<attributes>[^>]*)>(?P<body>.*?)</script>", re.DOTALL | re.IGNORECASE)

PLAIN_HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "x-frame-options": "SAMEORIGIN",
    "permissions-policy": "camera=(), geolocation=(), microphone=(), payment=(), usb=()",
}

DEFAULT_CSP = "default-src 'none'; frame-ancestors 'self'; base-uri 'none'"

VIEWER_CSP = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' blob: data:; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'self'; frame-ancestors 'self'"
)
"""The embedded Rerun viewer: its telemetry and update hosts are out of reach."""


def page_csp(html: str, host: str) -> str:
    """The policy for one page: own files only, and exactly the inline scripts that stand in it."""
    hashes = []
    for match in _INLINE_SCRIPT.finditer(html):
        attributes = match["attributes"].lower()
        if "src=" in attributes or "application/json" in attributes:
            continue
        digest = base64.b64encode(hashlib.sha256(match["body"].encode()).digest()).decode()
        hashes.append(f"'sha256-{digest}'")
    scripts = " ".join(["'self'", *hashes])
    # Older browsers don't let 'self' cover WebSockets; the Host header has passed the host check.
    sockets = f" ws://{host} wss://{host}" if re.fullmatch(r"[\w.\-\[\]:]+", host) else ""
    return (
        f"default-src 'self'; script-src {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
        f"font-src 'self' data:; connect-src 'self'{sockets}; worker-src 'self' blob:; frame-src 'self'; "
        "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'self'"
    )


def allowed_hosts(settings: Settings) -> list[str]:
    """Names that the Host header may carry (ports excluded); keeps other sites' names from resolving to us."""
    hosts = ["localhost", "127.0.0.1", "[::1]", *settings.allowed_hosts]
    if not is_loopback(settings.host):
        if settings.host in ("0.0.0.0", "::"):
            return ["*"]  # reached under names we can't know; the token guards it
        hosts.append(settings.host)
    return list(dict.fromkeys(hosts))


def host_allowed(host_header: str, hosts: list[str]) -> bool:
    if "*" in hosts:
        return True
    try:
        name = urlsplit(f"//{host_header}").hostname or ""
    except ValueError:
        return False
    return name in {h.strip("[]").lower() for h in hosts}


def same_origin(origin: str | None, host_header: str, scheme_secure: bool | None = None) -> bool:
    """True when a request's Origin is the page's own host; absent (a program, not a browser) counts as own."""
    if origin is None:
        return True
    parts = urlsplit(origin)
    if parts.scheme not in ("http", "https"):
        return False
    if scheme_secure is not None and scheme_secure and parts.scheme != "https":
        return False
    return parts.netloc.lower() == host_header.lower()


def given_token(headers: Headers, query: str, cookie_name: str) -> str | None:
    """The token that a request shows: Authorization header, else `?token=`, else cookie."""
    authorization = headers.get("authorization", "")
    if authorization.lower().startswith("bearer "):
        return authorization[7:].strip()
    if values := parse_qs(query).get("token"):
        return values[0]
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(cookie_name)
    except CookieError:
        return None
    return cookie.value if cookie else None


def token_matches(given: str | None, expected: str) -> bool:
    """Compared in constant time, as digests, so that neither content nor length shows."""
    left = hashlib.sha256((given or "").encode()).digest()
    right = hashlib.sha256(expected.encode()).digest()
    return hmac.compare_digest(left, right) and bool(given)


class Gate:
    """Host, Origin and token checks, body limit and headers, for HTTP and WebSocket requests alike."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app = app
        self.settings = settings
        self.hosts = allowed_hosts(settings)
        self.cookie = COOKIE.format(port=settings.port)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self.refusal(scope, headers)
        if scope["type"] == "websocket":
            if refusal is not None:
                await receive()
                await send({"type": "websocket.close", "code": 4403, "reason": refusal[1][:120]})
                return
            await self.app(scope, receive, send)
            return
        send = _with_headers(send)
        if refusal is not None:
            await _drain(receive)
            await _answer(send, *refusal)
            return
        if await self._enter_with_token(scope, headers, send):
            return
        await self._limited(scope, headers, receive, send)

    def refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        """Status and sentence when the request must not pass."""
        host = headers.get("host", "")
        if not host_allowed(host, self.hosts):
            return 400, f"this dashboard isn't known as {host[:80]!r}; open it under the address that it printed"
        origin = headers.get("origin")
        unsafe = scope["type"] == "websocket" or scope["method"] in UNSAFE_METHODS
        if unsafe and (not same_origin(origin, host) or headers.get("sec-fetch-site") in ("cross-site", "same-site")):
            return 403, "the request came from another site and was refused"
        if self.settings.token and scope["path"] not in OPEN_PATHS:
            query = scope.get("query_string", b"").decode("latin-1")
            if not token_matches(given_token(headers, query, self.cookie), self.settings.token):
                return 401, "a token is needed: open the address with ?token=… that the dashboard printed on its start"
        return None

    async def _enter_with_token(self, scope: Scope, headers: Headers, send: Send) -> bool:
        """A page opened with ?token= keeps it in a cookie and goes on without it in the address."""
        query = scope.get("query_string", b"").decode("latin-1")
        pairs = parse_qsl(query, keep_blank_values=True)
        wants_page = scope["method"] == "GET" and "text/html" in headers.get("accept", "")
        if not self.settings.token or not wants_page or all(name != "token" for name, _ in pairs):
            return False
        rest = urlencode([(name, value) for name, value in pairs if name != "token"])
        path = "/" + scope["path"].lstrip("/\\")
        target = path + (f"?{rest}" if rest else "")
        secure = "; Secure" if scope.get("scheme") == "https" else ""
        cookie = f"{self.cookie}={self.settings.token}; Path=/; HttpOnly; SameSite=Strict; Max-Age=2592000{secure}"
        start: Message = {
            "type": "http.response.start",
            "status": 303,
            "headers": [
                (b"location", target.encode("ascii", "ignore")),
                (b"set-cookie", cookie.encode("latin-1")),
                (b"cache-control", b"no-store"),
            ],
        }
        await send(start)
        await send({"type": "http.response.body", "body": b""})
        return True

    async def _limited(self, scope: Scope, headers: Headers, receive: Receive, send: Send) -> None:
        """Passes the request on when its body is small enough; a body too large is read away and refused."""
        limit = self.settings.body_limit
        sentence = f"a request may carry at most {limit // 2**20} MB"
        announced = headers.get("content-length", "0")
        if not announced.isdigit() or int(announced) > limit:
            await _drain(receive)
            await _answer(send, 413, sentence)
            return
        if scope["method"] not in UNSAFE_METHODS:
            await self.app(scope, receive, send)
            return
        chunks: list[bytes] = []
        size = 0
        while True:
            message = await receive()
            if message["type"] == "http.disconnect":
                return
            size += len(message.get("body", b""))
            if size > limit:
                if message.get("more_body", False):
                    await _drain(receive)
                await _answer(send, 413, sentence)
                return
            chunks.append(message.get("body", b""))
            if not message.get("more_body", False):
                break
        await self.app(scope, _replay(b"".join(chunks), receive), send)


def _replay(body: bytes, receive: Receive) -> Receive:
    """A `receive` that hands out the body already read, then whatever comes next."""
    handed = False

    async def again() -> Message:
        nonlocal handed
        if handed:
            return await receive()
        handed = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again


def _with_headers(send: Send) -> Send:
    """Adds the headers that every answer carries; an answer's own policy stays."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in PLAIN_HEADERS.items():
                headers.setdefault(name, value)
            headers.setdefault("content-security-policy", DEFAULT_CSP)
        await send(message)

    return sending


async def _drain(receive: Receive) -> None:
    """Reads a body away, so that the client gets to read the answer; gives up on an endless one."""
    size = 0
    while size < DRAIN_LIMIT:
        message = await receive()
        if message["type"] != "http.request" or not message.get("more_body", False):
            return
        size += len(message.get("body", b""))


async def _answer(send: Send, status: int, sentence: str) -> None:
    body = json.dumps({"error": sentence}, ensure_ascii=False).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
    if status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
