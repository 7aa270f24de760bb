"""The templates of programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from estimator.export.program import Program

if TYPE_CHECKING:
    from jinja2 import Environment


def loaded() -> Environment:
    """Return the environment; a name that a template asks for and nobody gives is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("estimator.export"),
        # Programs, no HTML: quotes stay quotes.
        autoescape=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def rendered(
    program: Program, templates: Environment, endings: Mapping[str, str], **words: str
) -> dict[str, str]:
    """Return the files of a program, name to text.

    Parameters
    ----------
    program : Program
        What is in them.
    templates : Environment
        `loaded`, with the filters of a language.
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
