"""Rendering of the program templates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from estimator.export.program import Program

if TYPE_CHECKING:
    from jinja2 import Environment


def rendered(
    program: Program, templates: Environment, endings: Mapping[str, str], **words: str
) -> dict[str, str]:
    """Return the text of a program's files by name; `endings` maps endings to templates."""
    return {
        f"{program.name}{ending}": templates.get_template(template).render(
            **program.common, **words
        )
        for ending, template in endings.items()
    }
