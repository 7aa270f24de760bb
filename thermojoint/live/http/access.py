"""Middleware for all requests: limits, authentication, headers."""

from __future__ import annotations

import sqlite3
import time
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from thermojoint.live.accounts import Accounts
from thermojoint.live.dashboard.assets import OPEN
from thermojoint.live.http.hosts import misdirected
from thermojoint.live.http.token_buckets import MOST_CLIENTS, RateLimit, client_of
from thermojoint.live.rights import Principal

#: Longest address with its parameters, and all headers together, bytes.
LONGEST_ADDRESS, LARGEST_HEAD = 2048, 16384
#: Largest burst of requests of a client, in seconds of its rate.
BURST_S = 5.0
#: Allowed wrong tokens and passwords of one client in a row; time until each is forgotten, s.
WRONG_TOKENS, FORGOTTEN_S = 10.0, 10.0
#: No content from other sites, no inline code, no frames. The one hash is that of the empty style
#: element into which plotly.js inserts its rules.
POLICY = (
    "default-src 'none'; script-src 'self'; connect-src 'self'; img-src 'self' data: blob:; "
    "style-src 'self' 'sha256-47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU='; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}


@dataclass(eq=False)
class AccessControl:
    """Access rights and rate limits."""

    accounts: Accounts
    #: Host names of the service.
    hosts: frozenset[str]
    #: Whether TLS is used; the session's cookie is then sent over TLS only.
    secure: bool
    #: Time for which a browser stays logged in, s.
    session: float
    #: `requests`, `failures`: requests and refused log-ins of each client.
    requests: RateLimit
    failures: RateLimit = field(default_factory=lambda: RateLimit(1.0 / FORGOTTEN_S, WRONG_TOKENS))
    _audited_tokens: dict[tuple[str, str], None] = field(default_factory=dict)

    @property
    def cookie(self) -> str:
        """Name of the session's cookie; the prefix binds it to TLS and to this host."""
        return "__Host-thermojoint" if self.secure else "thermojoint"

    def note_token(self, principal: Principal, scope: Scope) -> None:
        """Audit a token at its first use from an address."""
        key = (principal.credential, client(scope))
        if key not in self._audited_tokens:
            self.accounts.audit.accepted(principal.name, origin(scope), "token")
            self._audited_tokens[key] = None
            if len(self._audited_tokens) > MOST_CLIENTS:
                del self._audited_tokens[next(iter(self._audited_tokens))]


def refused(status: int, text: str, **headers: str) -> Response:
    """Return a response with the reason for a refusal."""
    return JSONResponse({"error": text}, status, headers)


def too_many(waiting: float) -> Response:
    """Return the response to a client with too many requests."""
    seconds = str(int(waiting) + 1)
    return refused(429, f"too many requests; ask again in {seconds} s", **{"retry-after": seconds})


def client(scope: Scope) -> str:
    """Return the client of a request."""
    peer = scope.get("client")
    return client_of(peer[0]) if peer else ""


def ticket_of(scope: Scope, name: str) -> str:
    """Return the session's ticket from a browser's cookie; empty without one."""
    return HTTPConnection(scope).cookies.get(name, "")


def origin(scope: Scope) -> str:
    """Return the origin of a request, in the form of the audit log."""
    peer = scope.get("client")
    return f"http {peer[0]}" if peer else "http"


def wrong_secret(access: AccessControl, scope: Scope, who: str, what: str) -> Response | None:
    """Note a wrong password or token; return a response if it is one too many."""
    waiting = access.failures.take(client(scope), time.monotonic())
    why = "too many wrong ones" if waiting > 0.0 else "wrong, revoked or expired"
    access.accounts.audit.refused(who, origin(scope), what, why)
    return too_many(waiting) if waiting > 0.0 else None


def with_headers(send: Send, secure: bool) -> Send:
    """Return a `send` function that adds `HEADERS` to responses."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
            headers.setdefault("cache-control", "no-store")
            if secure:
                headers["strict-transport-security"] = "max-age=31536000"
        await send(message)

    return sent


def oversized(scope: Scope, headers: Headers) -> Response | None:
    """Return the response to a request with too large headers or an unexpected body."""
    if len(scope["raw_path"]) + len(scope["query_string"]) > LONGEST_ADDRESS:
        return refused(414, f"the address has more than {LONGEST_ADDRESS} bytes; shorten it")
    if sum(len(name) + len(value) for name, value in scope["headers"]) > LARGEST_HEAD:
        return refused(431, f"the headers have more than {LARGEST_HEAD} bytes; send fewer")
    if scope["method"] != "POST" and (
        headers.get("content-length", "0") != "0" or "transfer-encoding" in headers
    ):
        return refused(413, "only POST requests have a body; leave it out", connection="close")
    return None


class AccessMiddleware:
    """Wrapper of an application: refuses requests, and adds the headers to every response."""

    def __init__(self, app: ASGIApp, access: AccessControl) -> None:
        self.app, self.access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return
        try:
            answer = self._refusal(scope)
        except (sqlite3.Error, OSError) as error:
            answer = refused(503, f"log-ins cannot be checked or audited now ({error})")
        if answer is not None and answer.status_code == 413:
            # A connection that is closed with unread data is reset, and the answer may be lost.
            with suppress(ClientDisconnect):
                await body_of(Request(scope, receive), LARGEST_HEAD)
        await (answer or self.app)(scope, receive, with_headers(send, self.access.secure))

    def _refusal(self, scope: Scope) -> Response | None:
        """Return the response to a request that is refused; None if it may pass."""
        waiting = self.access.requests.take(client(scope), time.monotonic())
        if waiting > 0.0:
            return too_many(waiting)
        headers = Headers(scope=scope)
        refusal = oversized(scope, headers)
        if refusal is not None:
            return refusal
        elsewhere = misdirected(headers, scope, self.access.hosts)
        if elsewhere is not None:
            status, why = elsewhere
            if status == 403:
                self.access.accounts.audit.refused("", origin(scope), scope["path"][:40], why)
            return refused(status, why)
        if self._is_open(scope):
            return None
        return self._authenticate(scope, headers)

    def _is_open(self, scope: Scope) -> bool:
        path = scope["path"]
        if path in ("/login", "/healthz"):
            return True
        return path.startswith("/assets/") and path.rpartition("/")[2] in OPEN

    def _authenticate(self, scope: Scope, headers: Headers) -> Response | None:
        """Return the response to a request without a valid session or token."""
        accounts = self.access.accounts
        scheme, _, token = headers.get("authorization", "").partition(" ")
        check = partial(accounts.by_session, ticket_of(scope, self.access.cookie))
        principal = check()
        if principal is None and scheme.lower() == "bearer":
            check = partial(accounts.by_token, token.strip())
            principal = check()
            if principal is None:
                answer = wrong_secret(self.access, scope, "", "token")
                if answer is not None:
                    return answer
            else:
                self.access.note_token(principal, scope)
        if principal is not None:
            # `check` is called again while a stream lasts.
            scope["user"], scope["check"] = principal, check
            return None
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
