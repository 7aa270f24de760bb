"""Host and Origin of a request: only names of this service, only pages of its own.

A page of another site can make a browser send requests to this service, under a name that it points
to this address (DNS rebinding) or with this service's cookie.
"""

from __future__ import annotations

import socket
from pathlib import Path
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import Scope

from thermojoint.live.certificates import names_in
from thermojoint.live.settings import HttpServer


def hosts_of(section: HttpServer, certificate: Path | None) -> frozenset[str]:
    """Return the names under which browsers and programs reach the service.

    Those in its certificate count as well; without TLS it is None.
    """
    own = ["localhost", "127.0.0.1", "::1", socket.gethostname(), section.address]
    named = [] if certificate is None else names_in(certificate)
    return frozenset(name.lower() for name in (*own, *named, *section.host_names))


def misdirected(headers: Headers, scope: Scope, hosts: frozenset[str]) -> tuple[int, str] | None:
    """Return status and reason if a request is not meant for this service; None if it is.

    The address at which it arrived also counts as a name.
    """
    own = hosts | {str((scope.get("server") or ("",))[0]).lower()}
    given = headers.get("host", "")
    if _host(f"//{given}") not in own:
        return 421, "this name is not the service's; add it to host_names of [http]"
    if headers.get("origin", own_origin := f"{scope['scheme']}://{given}") != own_origin:
        return 403, "the request comes from a page of another site"
    return None


def _host(url: str) -> str:
    try:
        return (urlsplit(url).hostname or "").lower()
    except ValueError:
        return ""
