"""Errors that a user can act on: one line with the mistake, its place, and the remedy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches

#: Names that a message lists.
MOST_NAMES = 20


class ThermojointError(Exception):
    """Base class of the errors of this project."""


class InputError(ThermojointError, ValueError):
    """Invalid input, detected before any long computation.

    The message is one line: the mistake, its place, and the remedy.
    """


class InputErrors(InputError):
    """Several mistakes in one input: a line for each, in the form of `InputError`."""


class UnreadableError(InputError):
    """A file cannot be read or has changed, or something is not installed here.

    A later attempt, or one on another computer, may succeed.
    """


class ConvergenceError(ThermojointError, ArithmeticError):
    """A solver did not reach its tolerance, even with a smaller step."""


def unknown_name(kind: str, name: str, known: Iterable[str], where: str) -> InputError:
    """Return the error for an unknown name of a kind; it suggests the closest known name."""
    names = sorted(known)
    near = get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}?" if near else f"known: {_listed(names)}"
    return InputError(f"{where}: no {kind} named {name!r}; {hint}")


def _listed(names: Sequence[str]) -> str:
    """Names as text on one line that can be read: of many only the first."""
    more = len(names) - MOST_NAMES
    some = ", ".join(names[:MOST_NAMES]) or "none"
    return some if more <= 0 else f"{some} and {more} more"


def shown_point(point: Iterable[float]) -> str:
    """Return coordinates as text for an error message."""
    return f"({', '.join(f'{float(x):.6g}' for x in point)})"
