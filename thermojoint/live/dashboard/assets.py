"""Assets of the pages: styles, scripts and plotly.js, in memory, compressed.

Their URLs in the pages contain a digest, so that a browser caches each file exactly as long as it
is unchanged.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable

#: Files of the log-in page, served without log-in.
OPEN = ("dashboard.css", "theme.js", "icon.svg")
_OWN = (*OPEN, "common.js", "overview.js", "machine.js", "charts.js", "scene.js")
_KINDS = {
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
PLOTLY = "plotly.min.js"


@dataclass(frozen=True, eq=False)
class Asset:
    """One file."""

    #: Media type.
    kind: str
    #: Content as it is, and compressed by gzip.
    plain: bytes
    packed: bytes
    #: Beginning of its SHA-256.
    digest: str


@cache
def asset(name: str) -> Asset | None:
    """Return a file by its name; None if there is none."""
    if name == PLOTLY:
        file = files("plotly").joinpath("package_data", PLOTLY)
    elif name in _OWN:
        file = files("thermojoint.live.dashboard").joinpath("templates", name)
    else:
        return None
    return packed(file)


def packed(file: Traversable) -> Asset:
    """Return a file of a package."""
    plain = file.read_bytes()
    kind = _KINDS[file.name.rpartition(".")[2]]
    return Asset(kind, plain, gzip.compress(plain, 6, mtime=0), sha256(plain).hexdigest()[:16])
