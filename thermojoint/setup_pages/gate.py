"""Access to the pages: only for the browser that opened the link printed by the command."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from hmac import compare_digest
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from thermojoint.live.http.access import oversized, refused, ticket_of, with_headers
from thermojoint.live.http.hosts import misdirected


@dataclass(eq=False)
class Key:
    """The link's token, valid for one browser, and the sessions begun by such links."""

    #: Host names of the pages.
    hosts: frozenset[str]
    #: Part of the cookie's name, since cookies are shared between ports.
    port: int
    #: Token of the next link.
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32))
    sessions: set[str] = field(default_factory=set)

    @property
    def cookie(self) -> str:
        """Name of the session's cookie."""
        return f"thermojoint-setup-{self.port}"

    @property
    def link(self) -> str:
        """Link for the next browser."""
        return f"http://127.0.0.1:{self.port}/?token={self.token}"

    def begun(self, token: str) -> Response | None:
        """Return the response that begins a session; None for a wrong token."""
        if not compare_digest(token.encode(), self.token.encode()):
            return None
        self.token, session = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
        self.sessions.add(session)
        print(f"opened; for another browser: {self.link}", flush=True)
        answer = RedirectResponse("/", 303)
        answer.set_cookie(self.cookie, session, httponly=True, samesite="strict")
        return answer


class Gate:
    """Wrapper of the pages: refuses requests, and adds the headers to every response."""

    def __init__(self, app: ASGIApp, key: Key) -> None:
        self.app, self.key = app, key

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] == "http":
            await (self._stopped(scope) or self.app)(scope, receive, with_headers(send, False))

    def _stopped(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        if (refusal := oversized(scope, headers)) is not None:
            return refusal
        if (elsewhere := misdirected(headers, scope, self.key.hosts)) is not None:
            return refused(*elsewhere)
        if scope["method"] == "POST" and "origin" not in headers:
            return refused(403, "no page of this program sends this; the header Origin is missing")
        if ticket_of(scope, self.key.cookie) in self.key.sessions:
            return None
        token = parse_qs(scope["query_string"].decode("ascii", "replace")).get("token", [""])[0]
        began = self.key.begun(token) if scope["path"] == "/" and scope["method"] == "GET" else None
        return began or PlainTextResponse(
            "Open the newest link that 'thermojoint setup' printed; each is good for one browser.",
            401,
        )
