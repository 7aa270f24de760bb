"""The pages, rendered from their templates."""

from __future__ import annotations

from functools import cache
from typing import Any

from jinja2 import Environment

from thermojoint.artefacts.templates import templates_of
from thermojoint.live.dashboard.assets import address


@cache
def _environment() -> Environment:
    made = templates_of("thermojoint.live.dashboard")
    made.globals["asset"] = address
    return made


def page(name: str, **values: Any) -> str:  # noqa: ANN401
    """Return a page as HTML; every value is escaped."""
    return _environment().get_template(f"{name}.html").render(**values)
