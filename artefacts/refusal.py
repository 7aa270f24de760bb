"""What pydantic found wrong with an input, said in one line."""

from __future__ import annotations

from pydantic_core import ErrorDetails

from artefacts.errors import InputError


def refusal(found: ErrorDetails, at: str) -> InputError:
    """Return the error for a missing key or a bad value.

    Parameters
    ----------
    found : ErrorDetails
        One of ``ValidationError.errors()``.
    at : str
        File and key.
    """
    if found["type"] == "missing":
        return InputError(f"{at} is missing; add it")
    message = found["msg"].removeprefix("Value error, ")
    given = found.get("input")
    shown = f" (given: {given!r})" if isinstance(given, str | int | float) else ""
    return InputError(f"{at}: {message[0].lower()}{message[1:]}{shown}; change it")
