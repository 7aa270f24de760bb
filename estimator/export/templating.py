"""The templates of programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from estimator.export.program import Program

if TYPE_CHECKING:
    from jinja2 import Environment


def rendered(
    program: Program, templates: Environment, endings: Mapping[str, str], **words: str
) -> dict[str, str]:
    """Return the files of a program, name to text.

    Parameters
    ----------
    program : Program
        What is in them.
    templates : Environment
        From `thermojoint.artefacts.templates.templates_of`, with the filters of a language.
    endings : mapping
        What follows the program's name in the name of a file, to its template.
    **words : str
        Of the language.
    """
    return {
        f"{program.name}{ending}": templates.get_template(template).render(
            **program.common, **words
        )
        for ending, template in endings.items()
    }
