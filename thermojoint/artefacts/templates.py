"""Templates of pages and programs: one environment for all of them, and the frame of a report."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment


def templates_of(*packages: str) -> Environment:
    """Return the templates in the folders ``templates`` of packages, searched in this order.

    Reports extend ``page.html.j2`` beside this module, which needs a ``title`` and the command that
    writes them as ``generator``. An undefined name in a template is an error. Values are escaped in
    HTML templates only.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=ChoiceLoader(
            [*map(PackageLoader, packages), PackageLoader("thermojoint.artefacts")]
        ),
        autoescape=lambda name: name is None or ".html" in name,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
