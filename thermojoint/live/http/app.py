"""The application: routes and their handlers."""

from __future__ import annotations

import asyncio
import sqlite3
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any, TypeVar
from urllib.parse import parse_qs, parse_qsl

import anyio.to_thread
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from estimator.quality import Quality
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.live.dashboard.assets import Asset, asset
from thermojoint.live.dashboard.pages import page
from thermojoint.live.former_models import SHOWN
from thermojoint.live.http.access import (
    AccessControl,
    AccessMiddleware,
    body_of,
    client,
    origin,
    refused,
    too_many,
    wrong_secret,
)
from thermojoint.live.http.backend import Backend
from thermojoint.live.http.bodies import Messages, events_body, history_body, machine_body, summary
from thermojoint.live.http.parameters import moment, number, one_of, read_parameters, whole_number
from thermojoint.live.http.stream import CountedStream, Subscriber, stream
from thermojoint.live.publication import as_json
from thermojoint.live.scene import Scene

#: Largest number of rows of the history, and of events, per request.
MOST_POINTS, MOST_EVENTS = 5000, 1000
#: Default time span, s.
USUAL_HISTORY, USUAL_EVENTS = 8 * 3600.0, 7 * 86400.0
#: Largest body of a log-in, bytes.
LARGEST_LOGIN = 4096
#: Range of displacements that can be entered, um.
READ_UM = -1e4, 1e4
#: Largest number of requests that read the history at the same time; others wait.
READERS = 4
_NOT_YET = "nothing is known of {} yet; ask again later"

Content = TypeVar("Content")


def asset_answer(request: Request, content: Asset | None) -> Response:
    """Return a style sheet or a script, compressed if possible."""
    if content is None or content.digest != request.path_params["digest"]:
        raise HTTPException(404, "no such file; load the page again")
    headers = {"cache-control": "private, max-age=31536000, immutable", "vary": "accept-encoding"}
    packed = "gzip" in request.headers.get("accept-encoding", "")
    if packed:
        headers["content-encoding"] = "gzip"
    return Response(content.packed if packed else content.plain, 200, headers, content.kind)


@dataclass(eq=False)
class Handlers:
    """Handlers of requests."""

    backend: Backend
    access: AccessControl
    #: `most_streams`, `streams`: largest and present number of streams.
    most_streams: int
    streams: int = 0
    _publications: Messages = field(default_factory=lambda: Messages(as_json))
    _summaries: Messages = field(default_factory=lambda: Messages(summary))
    _reading: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(READERS))

    def routes(self) -> list[Route]:
        """Return the addresses."""
        machine = "/api/machines/{machine}"
        return [
            Route("/", self.overview),
            Route("/machines/{machine}", self.machine),
            Route("/machines/{machine}/rollback", self.rollback, methods=["POST"]),
            Route("/machines/{machine}/next-reading", self.postpone, methods=["POST"]),
            Route("/machines/{machine}/reading", self.read, methods=["POST"]),
            Route("/login", self.login, methods=["GET", "POST"]),
            Route("/logout", self.logout, methods=["POST"]),
            Route("/assets/{digest}/{name}", self.asset),
            Route("/api/machines", self.machines),
            Route(machine, self.about),
            Route(f"{machine}/latest", self.latest),
            Route(f"{machine}/history", self.history),
            Route(f"{machine}/scene", self.scene),
            Route(f"{machine}/fields", self.fields),
            Route(f"{machine}/residuals", self.residuals),
            Route(f"{machine}/handshake", self.handshake),
            Route(f"{machine}/control", self.control, methods=["POST"]),
            Route("/api/events", self.events),
            Route("/api/stream", self.stream),
            Route("/metrics", self.metrics),
            Route("/healthz", self.health),
        ]

    async def overview(self, request: Request) -> Response:
        """Return the page of all machines."""
        return HTMLResponse(page("overview"))

    async def machine(self, request: Request) -> Response:
        """Return the page of one machine."""
        name = self._machine(request)
        engineer = not request.user.refusal("engineer", name)
        former = self.backend.former(name) if engineer else None
        return HTMLResponse(page("machine", machine=name, former=former))

    async def rollback(self, request: Request) -> Response:
        """Roll a machine back to its former model."""
        name = self._machine(request)
        former, why = self.backend.former(name), request.user.refusal("engineer", name)
        if why or former is None:
            why = why or "no former model is kept"
            raise self._refused(request, 403 if former else 404, "rollback", why)
        self._accept(request, f"rollback to model {former.file} {former.fingerprint[:SHOWN]}")
        self.backend.roll_back(name)
        return RedirectResponse(f"/machines/{name}", 303)

    async def postpone(self, request: Request) -> Response:
        """Postpone the displacement reading requested for a machine."""
        name = self._machine(request)
        if why := request.user.refusal("operator", name):
            raise self._refused(request, 403, "postpone", why)
        self._accept(request, "postpone the next reading")
        self.backend.postpone(name)
        return RedirectResponse(f"/machines/{name}", 303)

    async def read(self, request: Request) -> Response:
        """Receive displacement readings entered by an operator: ``x_um=-3.1``."""
        name = self._machine(request)
        if why := request.user.refusal("operator", name):
            raise self._refused(request, 403, "reading", why)
        parsers = dict.fromkeys(self.backend.machines[name].probes, number(*READ_UM))
        body = await body_of(request, LARGEST_LOGIN) or b""
        pairs = parse_qsl(body.decode("utf-8", "replace"), keep_blank_values=True)
        if not (parsers and pairs):
            raise InputError(f"no reading; {name} takes: {', '.join(parsers) or 'none'}")
        given = read_parameters(pairs, parsers)
        self._accept(request, "reading of " + ", ".join(f"{k} = {v:g}" for k, v in given.items()))
        if not self.backend.read(name, given):
            raise HTTPException(503, "too many readings wait; enter it again in a moment")
        return RedirectResponse(f"/machines/{name}", 303)

    async def control(self, request: Request) -> Response:
        """Receive an answer of a machine's control: the handshake."""
        name = self._machine(request)
        why = f'{name}: no control answers here; set handshake.by = "http"'
        owner, take = _or_404(self.backend.controls.get(name), why)
        why = request.user.refusal("operator", name)
        if owner not in (None, request.user.name):
            why = f"only {owner} writes for the control"
        if why:
            raise self._refused(request, 403, "control", why)
        body = await body_of(request, LARGEST_LOGIN)
        try:
            audit = self.access.accounts.audit
            audit.written(request.user.name, origin(request.scope), "control", name)
            take(body or b"")
        except ValueError as error:
            raise HTTPException(400, f"what the control says is no answer: {error}") from error
        return JSONResponse({"handshake": self.backend.publisher.newest[name].handshake})

    async def login(self, request: Request) -> Response:
        """Show the log-in page, or check a password or token."""
        if request.method != "POST":
            return HTMLResponse(page("login", wrong=False))
        access = self.access
        waiting = access.failures.wait(client(request.scope), time.monotonic())
        if waiting > 0.0:
            return too_many(waiting)
        body = await body_of(request, LARGEST_LOGIN)
        if body is None:
            raise HTTPException(413, "the body is too large; send name and password alone")
        given = parse_qs(body.decode("utf-8", "replace"), max_num_fields=4)
        name, secret = (given.get(key, [""])[0].strip() for key in ("name", "token"))
        accounts = access.accounts
        found = accounts.by_password(name, secret) if name else accounts.by_token(secret)
        if found is None:
            answer = wrong_secret(access, request.scope, name, "login")
            return answer or HTMLResponse(page("login", wrong=True), 401)
        try:
            ticket = accounts.begin(found, access.session)
            accounts.audit.accepted(found.name, origin(request.scope), "login")
        except (sqlite3.Error, OSError) as error:
            return refused(503, f"the log-in cannot be kept or audited now ({error})")
        done = RedirectResponse("/", 303)
        done.set_cookie(
            access.cookie,
            ticket,
            max_age=int(access.session),
            secure=access.secure,
            httponly=True,
            samesite="strict",
        )
        return done

    async def logout(self, request: Request) -> Response:
        """End the session, here and in the browser."""
        self.access.accounts.end(request.cookies.get(self.access.cookie, ""))
        self.access.accounts.audit.accepted(request.user.name, origin(request.scope), "logout")
        done = RedirectResponse("/login", 303)
        done.delete_cookie(
            self.access.cookie, secure=self.access.secure, httponly=True, samesite="strict"
        )
        return done

    async def asset(self, request: Request) -> Response:
        """Return a style sheet or a script."""
        return asset_answer(request, asset(request.path_params["name"]))

    async def machines(self, request: Request) -> Response:
        """Return a summary of all machines."""
        read_parameters(request.query_params.multi_items(), {})
        newest = self.backend.publisher.newest
        return JSONResponse(
            {
                "now_s": time.time(),
                "machines": [
                    {"machine": name, "kind": about.kind, "model": about.model}
                    | (summary(newest[name]) if name in newest else {})
                    for name, about in self.backend.machines.items()
                    if request.user.sees(name)
                ],
            }
        )

    async def about(self, request: Request) -> Response:
        """Return the constant data of a machine."""
        name = self._only_machine(request)
        further: dict[str, Collection[str]] = {
            "scene": self.backend.scenes,
            "residuals": self.backend.residuals,
            "handshake": self.backend.handshakes,
        }
        offers = [page for page in further if name in further[page]]
        return JSONResponse(machine_body(name, self.backend.machines[name], offers))

    async def latest(self, request: Request) -> Response:
        """Return the newest publication of a machine."""
        name = self._only_machine(request)
        newest = _or_404(self.backend.publisher.newest.get(name), _NOT_YET.format(name))
        return JSONResponse(as_json(newest))

    async def history(self, request: Request) -> Response:
        """Return the thinned history of a machine."""
        name = self._machine(request)
        since, until, given = self._span(
            request, USUAL_HISTORY, points=whole_number(2, MOST_POINTS)
        )
        async with self._reading:
            history = await anyio.to_thread.run_sync(
                self.backend.archive.history, name, since, until, given.get("points", 720)
            )
        return JSONResponse(history_body(name, history))

    async def events(self, request: Request) -> Response:
        """Return events, newest first."""
        since, until, given = self._span(
            request,
            USUAL_EVENTS,
            machine=one_of(*self._visible(request)),
            most=whole_number(1, MOST_EVENTS),
        )
        user, most = request.user, given.get("most", 100)

        def seen(machine: str | None) -> bool:
            # Events of the service itself may mention any machine.
            return user.sees_all or (machine is not None and user.sees(machine))

        async with self._reading:
            events = await anyio.to_thread.run_sync(
                self.backend.archive.events, given.get("machine"), since, until, most, seen
            )
        return JSONResponse(events_body(events))

    async def scene(self, request: Request) -> Response:
        """Return the 3-D shape of a machine."""
        name = self._only_machine(request)
        return JSONResponse(self._scene(name).shape)

    async def fields(self, request: Request) -> Response:
        """Return the fields of the newest state at every point of the shape."""
        name = self._only_machine(request)
        return JSONResponse(_or_404(self._scene(name).fields(), _NOT_YET.format(name)))

    async def residuals(self, request: Request) -> Response:
        """Return the residuals (reading minus model) of the newest sample."""
        name = self._only_machine(request)
        why = f"{name} has an estimator that does not expect readings"
        residuals = _or_404(self.backend.residuals.get(name), why)()
        body = {"machine": name, "residuals_K": _or_404(residuals, _NOT_YET.format(name))}
        return JSONResponse(body)

    async def handshake(self, request: Request) -> Response:
        """Return the handshake state of a machine's control."""
        name = self._only_machine(request)
        why = f"{name} has no handshake with its control"
        return JSONResponse({"machine": name, **_or_404(self.backend.handshakes.get(name), why)()})

    async def stream(self, request: Request) -> Response:
        """Return a stream of new samples."""
        given = read_parameters(
            request.query_params.multi_items(),
            {"machine": one_of(*self._visible(request)), "every_s": number(0.1, 60.0)},
        )
        if request.method == "HEAD":
            return Response(media_type="text/event-stream")
        if self.streams >= self.most_streams:
            return refused(
                429, f"{self.streams} streams are open already; close one", **{"retry-after": "10"}
            )
        wanted = [given["machine"]] if "machine" in given else self._visible(request)
        body = self._publications if "machine" in given else self._summaries
        every, check = given.get("every_s", 1.0), request.scope["check"]
        news = stream(self.backend.publisher, Subscriber(frozenset(wanted), every, check), body)
        self.streams += 1
        return CountedStream(news, self._stream_closed)

    def _stream_closed(self) -> None:
        self.streams -= 1

    def _refused(self, request: Request, status: int, what: str, why: str) -> HTTPException:
        """Return the refusal of a user's attempt on a machine, which is audited."""
        name, who = request.path_params["machine"], request.user.name
        self.access.accounts.audit.refused(who, origin(request.scope), what, why, name)
        return HTTPException(status, why)

    def _accept(self, request: Request, what: str) -> None:
        """Audit an action of a user on a machine; it is refused if it cannot be audited."""
        name, who = request.path_params["machine"], request.user.name
        try:
            self.access.accounts.audit.accepted(who, origin(request.scope), what, name)
        except OSError as error:
            raise HTTPException(503, f"this cannot be audited now ({error})") from error

    async def metrics(self, request: Request) -> Response:
        """Return the metrics for Prometheus."""
        if not request.user.sees_all:
            raise HTTPException(403, "the metrics are of all machines; log in as a user of all")
        return Response(
            generate_latest(self.backend.registry), headers={"content-type": CONTENT_TYPE_LATEST}
        )

    async def health(self, request: Request) -> Response:
        """Return the number of machines by quality, without their names, and the disk."""
        newest = self.backend.publisher.newest.values()
        counts = {
            one.word: sum(publication.quality is one for publication in newest) for one in Quality
        }
        disk = self.backend.disk()
        poor = counts[Quality.BAD.word] or disk.get("disk") == "full"
        return JSONResponse({"status": "degraded" if poor else "ok", "machines": counts} | disk)

    def _visible(self, request: Request) -> list[str]:
        """Return the machines that a user may see."""
        return [name for name in self.backend.machines if request.user.sees(name)]

    def _machine(self, request: Request) -> str:
        """Return the machine of a URL."""
        name, visible = str(request.path_params["machine"]), self._visible(request)
        if name not in visible:
            raise HTTPException(404, str(unknown_name("machine", name[:40], visible, "address")))
        return name

    def _only_machine(self, request: Request) -> str:
        """Return the machine of a URL without parameters."""
        name = self._machine(request)
        read_parameters(request.query_params.multi_items(), {})
        return name

    def _span(
        self, request: Request, usual: float, **parsers: Callable[[str], Any]
    ) -> tuple[float, float, dict[str, Any]]:
        """Return start and end, s since 1970, and the other parameters."""
        given = read_parameters(
            request.query_params.multi_items(), {"since": moment, "until": moment} | parsers
        )
        until = given.get("until", time.time())
        since = given.get("since", max(0.0, until - usual))
        if not since < until:
            raise InputError(f"since {since:.0f} is not before until {until:.0f}; change one")
        return since, until, given

    def _scene(self, name: str) -> Scene:
        why = f"{name} has no picture in 3-D; give the service a scene file"
        return _or_404(self.backend.scenes.get(name), why)


def _or_404(content: Content | None, why: str) -> Content:
    """Return content; refuse the request if there is none."""
    if content is None:
        raise HTTPException(404, why)
    return content


async def _bad_request(request: Request, error: Exception) -> Response:
    return refused(400, str(error))


async def _http_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    ours = {
        "Not Found": "no such address; docs/dashboard.md lists them",
        "Method Not Allowed": "no such method here",
    }
    text = ours.get(error.detail, error.detail)
    return refused(error.status_code, text, **(error.headers or {}))


def make_app(backend: Backend, access: AccessControl, most_streams: int) -> Starlette:
    """Return the application."""
    handlers = Handlers(backend, access, most_streams)
    made = Starlette(
        routes=handlers.routes(),
        middleware=[
            Middleware(AccessMiddleware, access=access),
            Middleware(GZipMiddleware, minimum_size=1000, compresslevel=4),
        ],
        exception_handlers={InputError: _bad_request, HTTPException: _http_error},
    )
    # It would redirect to the host named in the request.
    made.router.redirect_slashes = False
    return made
