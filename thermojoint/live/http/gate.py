"""Middleware for all requests: limits, authentication, headers."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from thermojoint.live.dashboard.assets import OPEN
from thermojoint.live.http.access import Access
from thermojoint.live.http.bodies import encoded
from thermojoint.live.http.rates import Buckets, client_of

log = logging.getLogger("thermojoint.http")

#: Longest address with its parameters, and all headers together, bytes.
LONGEST_ADDRESS, LARGEST_HEAD = 2048, 16384
#: Requests that a client may make at once, in seconds of its rate.
BURST_S = 5.0
#: Wrong tokens of one client in a row, and how long each is remembered, s.
WRONG_TOKENS, FORGOTTEN_S = 10.0, 10.0
#: Nothing from elsewhere, nothing written into the page, no frame around it. The one hash is that
#: of the empty style element, into which plotly.js then puts its rules.
POLICY = (
    "default-src 'none'; script-src 'self'; connect-src 'self'; img-src 'self' data: blob:; "
    "style-src 'self' 'sha256-47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU='; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}


@dataclass(eq=False)
class Door:
    """Access rights and rate limits.

    Attributes
    ----------
    access : Access
        The token.
    secure : bool
        With TLS: the ticket is then for TLS alone.
    requests, failures : Buckets
        Requests and wrong tokens of each client.
    """

    access: Access
    secure: bool
    requests: Buckets
    failures: Buckets = field(default_factory=lambda: Buckets(1.0 / FORGOTTEN_S, WRONG_TOKENS))

    @property
    def cookie(self) -> str:
        """Name of the ticket; by its prefix a browser takes it over TLS and for all pages alone."""
        return "__Host-thermojoint" if self.secure else "thermojoint"


def open_door(access: Access, secure: bool, requests_per_s: float) -> Door:
    """Return a door at which nobody has been."""
    return Door(access, secure, Buckets(requests_per_s, max(1.0, BURST_S * requests_per_s)))


def refused(status: int, text: str, **headers: str) -> Response:
    """Return an answer that says in one line why there is no other."""
    return Response(encoded({"error": text}), status, headers, "application/json")


def too_many(waiting: float) -> Response:
    """Return the answer to who asks too often."""
    seconds = str(int(waiting) + 1)
    return refused(429, f"too many requests; ask again in {seconds} s", **{"retry-after": seconds})


def client(scope: Scope) -> str:
    """Return who asks."""
    peer = scope.get("client")
    return client_of(peer[0]) if peer else ""


def ticket_of(headers: Headers, name: str) -> str:
    """Return the ticket that a browser sends; empty without one."""
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(name)
    except CookieError:
        return ""
    return cookie.value if cookie else ""


def wrong_token(door: Door, scope: Scope) -> Response | None:
    """Note a wrong token; returns the answer if it is one too many."""
    who, now = client(scope), time.monotonic()
    waiting = door.failures.take(who, now)
    if waiting > 0.0:
        return too_many(waiting)
    log.warning("http: wrong token from %s", who)
    return None


class Gate:
    """Around an application: answers itself what must not get in, adds the headers to the rest."""

    def __init__(self, app: ASGIApp, door: Door) -> None:
        self.app, self.door = app, door

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return
        secure = self.door.secure

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                headers.setdefault("cache-control", "no-store")
                if secure:
                    headers["strict-transport-security"] = "max-age=31536000"
            await send(message)

        answer = self._stopped(scope)
        await (answer or self.app)(scope, receive, with_headers)

    def _stopped(self, scope: Scope) -> Response | None:
        """The answer to a request that gets no further."""
        waiting = self.door.requests.take(client(scope), time.monotonic())
        if waiting > 0.0:
            return too_many(waiting)
        if len(scope["raw_path"]) + len(scope["query_string"]) > LONGEST_ADDRESS:
            return refused(414, f"the address has more than {LONGEST_ADDRESS} bytes; shorten it")
        if sum(len(name) + len(value) for name, value in scope["headers"]) > LARGEST_HEAD:
            return refused(431, f"the headers have more than {LARGEST_HEAD} bytes; send fewer")
        headers = Headers(scope=scope)
        if scope["method"] != "POST" and (
            headers.get("content-length", "0") != "0" or "transfer-encoding" in headers
        ):
            return refused(413, "a request that asks has no body; leave it out", connection="close")
        if self._is_open(scope):
            return None
        return self._unknown(scope, headers)

    def _is_open(self, scope: Scope) -> bool:
        path = scope["path"]
        if path in ("/login", "/healthz"):
            return True
        return path.startswith("/assets/") and path.rpartition("/")[2] in OPEN

    def _unknown(self, scope: Scope, headers: Headers) -> Response | None:
        """The answer to who has shown neither token nor ticket."""
        if self.door.access.valid(ticket_of(headers, self.door.cookie), time.time()):
            return None
        scheme, _, token = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            if self.door.access.admits(token.strip()):
                return None
            answer = wrong_token(self.door, scope)
            if answer is not None:
                return answer
        if scope["method"] in ("GET", "HEAD") and "text/html" in headers.get("accept", ""):
            return RedirectResponse("/login", 303)
        return refused(
            401,
            "show the token: Authorization: Bearer TOKEN, or log in at /login",
            **{"www-authenticate": "Bearer"},
        )


async def body_of(request: Request, most: int) -> bytes | None:
    """Return the body of a request; None if it has more than `most` bytes."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > most:
            return None
    return body
