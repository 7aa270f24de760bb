"""The pages, filled in."""

from __future__ import annotations

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from thermojoint.live.dashboard.assets import address


@cache
def _environment() -> Environment:
    made = Environment(
        loader=PackageLoader("thermojoint.live.dashboard"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals["asset"] = address
    return made


def page(name: str, **values: Any) -> str:  # noqa: ANN401
    """Return a page as HTML; every value is escaped."""
    return _environment().get_template(f"{name}.html").render(**values)
