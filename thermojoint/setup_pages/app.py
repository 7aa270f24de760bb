"""The application: GET shows a page of the table, POST performs its action."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple
from urllib.parse import parse_qs

import anyio.to_thread
from jinja2 import Environment
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response
from starlette.routing import Route

from thermojoint.artefacts.errors import ThermojointError
from thermojoint.live.dashboard.assets import Asset, packed
from thermojoint.live.dashboard.assets import asset as dashboard_asset
from thermojoint.live.dashboard.pages import page_templates
from thermojoint.live.http.access import body_of, refused
from thermojoint.live.http.app import asset_answer
from thermojoint.setup_pages import case_pages, control_pages, log_pages
from thermojoint.setup_pages.gate import Gate, Key
from thermojoint.setup_pages.place import SHOWN, ExistsError, Given, Place
from thermojoint.setup_pages.settings_files import RefusedError
from thermojoint.setup_pages.uploads import LARGEST_PIECE, take_piece

#: Largest form, bytes, and largest number of values in it.
LARGEST_FORM, MOST_VALUES = 1 << 20, 20_000
#: Files that a browser shows as text.
_TEXTS = (".csv", ".txt", ".tsv", ".toml", ".json", ".ini", ".former")
_OWN = ("setup.css", "upload.js")


class Page(NamedTuple):
    """One step."""

    title: str
    #: ``log`` or ``part``.
    way: str
    #: Returns the values for its template from the folder and the sent data.
    show: Callable[[Place, Given], dict[str, Any]]
    #: Performs its action with the sent data; raises InputError.
    do: Callable[[Place, Given], None]
    #: Whether the step is done; None: according to its record.
    done: Callable[[Place], bool] | None = None


#: Steps by their address, in order.
PAGES: Mapping[str, Page] = {
    "log": Page("Log", "log", log_pages.show_log, log_pages.do_log),
    "learn": Page("Learn", "log", log_pages.show_learn, log_pages.do_learn),
    "compare": Page("Compare", "log", log_pages.show_compare, log_pages.do_compare),
    "offsets": Page("Offsets", "log", control_pages.show_offsets, control_pages.do_offsets),
    "control": Page(
        "Control",
        "log",
        control_pages.show_control,
        control_pages.do_control,
        control_pages.is_complete,
    ),
    "try": Page(
        "Dry run", "log", control_pages.show_try, control_pages.do_try, control_pages.is_tried
    ),
    "run": Page(
        "Run", "log", control_pages.show_run, control_pages.do_run, control_pages.is_running
    ),
    "part": Page("Part", "part", case_pages.show_part, case_pages.do_part),
    "names": Page("Names", "part", case_pages.show_names, case_pages.do_names, case_pages.is_named),
    "case": Page("Case", "part", case_pages.show_case, case_pages.do_case),
    "result": Page("Result", "part", case_pages.show_result, case_pages.do_result),
}


@cache
def _asset(name: str) -> Asset | None:
    if name in _OWN:
        return packed(files("thermojoint.setup_pages").joinpath("templates", name))
    return dashboard_asset(name)


@cache
def _environment() -> Environment:
    return page_templates(_asset, "thermojoint.setup_pages", "thermojoint.live.dashboard")


def _rendered(place: Place, name: str, **values: Any) -> str:  # noqa: ANN401
    page, running = PAGES.get(name), place.jobs.running
    steps = [
        (key, one.title, one.done(place) if one.done else place.is_done(key))
        for key, one in PAGES.items()
        if page is not None and one.way == page.way
    ]
    keys = [key for key, *_ in steps]
    after = keys[keys.index(name) + 1 :] if page else []
    record = place.record(name)
    common = {
        "name": name,
        "title": page.title if page else "Set up",
        "folder": place.folder,
        "steps": steps,
        "next": (after[0], PAGES[after[0]].title) if after else None,
        "running": running,
        # Pages on which the user may be typing are not reloaded.
        "reloads": running is not None and (running[0] == name or running[0] not in PAGES),
        "record": record,
        "pictures": [one for one in record.written if one.endswith(".png") and place.has(one)],
        "stale": place.changed_since(name) if record.code == 0 else [],
        "has": place.has,
    }
    return _environment().get_template(f"{name}.html").render(**common, **values)


class Site:
    """Handlers of requests."""

    def __init__(self, place: Place) -> None:
        self.place = place

    def routes(self) -> list[Route]:
        """Return the addresses."""
        return [
            Route("/", self.start),
            Route("/assets/{digest}/{name}", self.asset),
            Route("/files/{name}", self.file),
            Route("/upload/{name}", self.upload, methods=["POST"]),
            Route("/cancel/{step}", self.cancel, methods=["POST"]),
            Route("/{step}", self.step, methods=["GET", "POST"]),
        ]

    def start(self, request: Request) -> Response:
        """Return the first page: the files of the folder, and the two ways."""
        place = self.place
        values = {"files": place.all_files(), "models": place.models()}
        return HTMLResponse(_rendered(place, "start", errors={}, ask=(), **values))

    async def asset(self, request: Request) -> Response:
        """Return a style sheet or a script."""
        return asset_answer(request, _asset(request.path_params["name"]))

    def file(self, request: Request) -> Response:
        """Return a file of the folder."""
        path = self.place.path(self.place.existing(request.path_params["name"]))
        if path.suffix.lower() not in SHOWN:
            raise HTTPException(404, "files of this kind are not shown here")
        if path.suffix == ".png":
            return FileResponse(path, media_type="image/png")
        if path.suffix in _TEXTS:
            return FileResponse(path, media_type="text/plain; charset=utf-8")
        return FileResponse(path, media_type="application/octet-stream", filename=path.name)

    async def upload(self, request: Request) -> Response:
        """Receive a piece of a file."""
        body = await body_of(request, LARGEST_PIECE)
        if body is None:
            raise HTTPException(413, "the piece is too large")
        query = request.query_params
        await anyio.to_thread.run_sync(
            take_piece, self.place, request.path_params["name"], body,
            query.get("at", ""), query.get("size", ""),
        )  # fmt: skip
        return Response(status_code=204)

    def cancel(self, request: Request) -> Response:
        """Stop the running step."""
        self.place.jobs.cancel()
        return RedirectResponse(f"/{request.path_params['step']}", 303)

    async def step(self, request: Request) -> Response:
        """Show a step, or perform its action with the sent data."""
        name = request.path_params["step"]
        if name not in PAGES:
            raise HTTPException(404, "no such page")
        given: Mapping[str, Sequence[str]] = {}
        if request.method == "POST":
            body = await body_of(request, LARGEST_FORM)
            if body is None:
                raise HTTPException(413, f"the form has more than {LARGEST_FORM} bytes")
            given = parse_qs(
                body.decode("utf-8", "replace"), keep_blank_values=True, max_num_fields=MOST_VALUES
            )
        return await anyio.to_thread.run_sync(self._answer, name, given, request.method)

    def _answer(self, name: str, given: Given, method: str) -> Response:
        """Perform the action and show the page, again with the sent data if it was refused."""
        errors: Mapping[str, Sequence[str]] = {}
        ask: Sequence[str] = ()
        if method == "POST":
            try:
                PAGES[name].do(self.place, given)
                return RedirectResponse(f"/{name}", 303)
            except ExistsError as error:
                errors, ask = {"": [str(error)]}, error.names
            except RefusedError as error:
                errors = error.lines
            except ThermojointError as error:
                errors = {"": str(error).splitlines()}
        try:
            shown = PAGES[name].show(self.place, given)
        except ThermojointError as error:
            errors, shown = {"": [*errors.get("", ()), *str(error).splitlines()]}, {}
        text = _rendered(self.place, name, errors=errors, ask=ask, shown=shown, given=given)
        return HTMLResponse(text, 400 if errors else 200)


async def _wrong(request: Request, error: Exception) -> Response:
    return refused(getattr(error, "status_code", 400), getattr(error, "detail", str(error)))


def make_app(place: Place, key: Key) -> Starlette:
    """Return the application."""
    made = Starlette(
        routes=Site(place).routes(),
        middleware=[Middleware(Gate, key=key)],
        exception_handlers={ThermojointError: _wrong, HTTPException: _wrong},
    )
    # It would redirect to the host named in the request.
    made.router.redirect_slashes = False
    return made
