"""Common parts of all commands: help for terminals of 80 columns, -q and -v."""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Callable
from functools import wraps
from typing import Annotated

import typer

from thermojoint import console

#: Width of a command in a help page: 80 columns without margins and backslash.
_WIDTH = 76
_EXAMPLE = re.compile(r"Example: \[bold\](.*)\[/bold\]", re.DOTALL)


def help_text(doc: str | None) -> str:
    """Return a docstring as help: paragraphs of one line, commands continued by backslashes."""
    return "\n\n".join(map(_paragraph, inspect.cleandoc(doc or "").split("\n\n")))


def _paragraph(text: str) -> str:
    if match := _EXAMPLE.fullmatch(text):
        lines = command_lines(" ".join(match[1].split()), _WIDTH)
        return "\n".join(["Example:", *(f"[bold]{line}[/bold]" for line in lines)])
    return " ".join(text.split())


def command_lines(command: str, width: int) -> list[str]:
    """Break a command before its options, each line but the last ending in a backslash."""
    first, *parts = re.split(r" (?=-)", command)
    lines = [first]
    for part in parts:
        if len(f"{lines[-1]} {part}") > width:
            lines[-1] += " \\\\"  # a single backslash is an escape in markup
            lines.append(f"  {part}")
        else:
            lines[-1] += f" {part}"
    return lines


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print warnings and errors only.")]
Verbose = Annotated[
    bool,
    typer.Option("--verbose", "-v", help="Also print how long each part took, and all warnings."),
]


def with_verbosity(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options -q and -v added to its own."""
    own = inspect.signature(command, eval_str=True)

    @wraps(command)
    def run(*, quiet: bool, verbose: bool, **given: object) -> None:
        if verbose:
            warnings.resetwarnings()
        console.set_verbosity(console.verbosity(quiet, verbose))
        command(**given)

    both = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
        for name, kind in (("quiet", Quiet), ("verbose", Verbose))
    ]
    signature = own.replace(parameters=[*own.parameters.values(), *both])
    run.__annotations__ = {
        parameter.name: parameter.annotation for parameter in signature.parameters.values()
    }
    vars(run)["__signature__"] = signature
    return run
