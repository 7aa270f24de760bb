"""The pages, rendered from their templates."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from jinja2 import Environment

from thermojoint.artefacts.templates import templates_of
from thermojoint.live.dashboard.assets import Asset, asset


def page_templates(of: Callable[[str], Asset | None], *packages: str) -> Environment:
    """Return the templates of packages; in them ``asset(NAME)`` is ``/assets/DIGEST/NAME``."""

    def address(name: str) -> str:
        content = of(name)
        assert content is not None, name
        return f"/assets/{content.digest}/{name}"

    made = templates_of(*packages)
    made.globals["asset"] = address
    return made


@cache
def _environment() -> Environment:
    return page_templates(asset, "thermojoint.live.dashboard")


def page(name: str, **values: Any) -> str:  # noqa: ANN401
    """Return a page as HTML; every value is escaped."""
    return _environment().get_template(f"{name}.html").render(**values)
