"""Errors that a user can act on: one line saying what is wrong, where, and what to do."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class ThermojointError(Exception):
    """Base of every error this project raises on purpose."""


class InputError(ThermojointError, ValueError):
    """Something the user gave is wrong; found before any long work starts.

    The message is one line: what is wrong, where, and what to do.
    """


class InputErrors(InputError):
    """Several mistakes in one input: the message has a line for each, as an `InputError` has."""


class UnreadableError(InputError):
    """A file cannot be read, or is not what it was; another time, or elsewhere, it may be."""


class ConvergenceError(ThermojointError, ArithmeticError):
    """A solver did not reach its tolerance, even after its step was cut."""


def unknown_name(kind: str, name: str, known: Iterable[str], where: str) -> InputError:
    """Return the error for a name that does not exist, with the nearest one that does.

    Parameters
    ----------
    kind : str
        What the name stands for, e.g. ``"surface"``.
    name : str
        The name that was asked for.
    known : iterable of str
        The names that exist.
    where : str
        Where the name was read or looked up.
    """
    names = sorted(known)
    near = get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(names) or 'none'}"
    return InputError(f"{where}: no {kind} named {name!r}; {hint}")


def shown_point(point: Iterable[float]) -> str:
    """Return coordinates as an error message shows them."""
    return f"({', '.join(f'{float(x):.6g}' for x in point)})"
