"""Formulas of position in a case file, e.g. ``sqrt(x_m**2 + y_m**2) + z_m``.

A case file must never run code: a formula is parsed, each of its parts is looked up in the lists
below, and arrays are computed from the parts. Nothing is compiled or passed to ``eval``, unlike in
the libraries for expressions (numexpr, asteval, sympy).
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from thermojoint.artefacts.arrays import Array, OfPosition
from thermojoint.artefacts.errors import unknown_name

#: From the name of a coordinate to its axis and the number of its units in 1 m.
COORDINATES = {
    f"{axis}_{unit}": (number, per_metre)
    for number, axis in enumerate("xyz")
    for unit, per_metre in (("m", 1.0), ("mm", 1e3))
}
CONSTANTS = {"pi": np.float64(np.pi)}
FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    name: (function, 1)
    for name, function in {
        "abs": np.abs,
        "sqrt": np.sqrt,
        "exp": np.exp,
        "log": np.log,
        "sin": np.sin,
        "cos": np.cos,
        "tan": np.tan,
        "asin": np.arcsin,
        "acos": np.arccos,
        "atan": np.arctan,
        "tanh": np.tanh,
    }.items()
} | {
    "atan2": (np.arctan2, 2),
    "hypot": (np.hypot, 2),
    "min": (np.minimum, 2),
    "max": (np.maximum, 2),
    "where": (np.where, 3),
}
_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_COMPARED: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
#: A longer formula is treated as a mistake.
LONGEST = 1000
#: Deeper nesting than this in a formula is treated as a mistake.
DEEPEST = 200


def formula(text: str) -> OfPosition:
    """Return the function of position defined by a formula.

    Parameters
    ----------
    text : str
        Numbers, `COORDINATES`, `CONSTANTS`, ``+ - * / **``, comparisons, brackets and
        `FUNCTIONS`; ``where(condition, then, otherwise)`` selects.

    Returns
    -------
    callable
        Function of position; NaN or infinite where the formula is undefined.

    Raises
    ------
    ValueError
        The formula is invalid; the message is one line with the reason.
    """
    if len(text) > LONGEST:
        raise ValueError(
            f"the formula has {len(text)} characters, more than {LONGEST}; give a file"
        )
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    # The parser raises these for text that is not an expression, empty, or nested too deeply.
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        raise ValueError(f"{text[:40]!r} is not a formula; write e.g. 5 + 2 * z_mm") from error
    _check(tree, DEEPEST)

    def values(points: Array) -> Array:
        with np.errstate(all="ignore"):
            result = np.asarray(_value(tree, points), dtype=np.float64)
        return np.array(np.broadcast_to(result, points.shape[1:]))

    return values


def _check(node: ast.expr, deeper: int) -> None:
    """Raise a ValueError for a part that is not in the lists."""
    if deeper == 0:
        raise ValueError("the formula is nested too deeply; write it simpler, or give a file")
    for part in _parts(node):
        _check(part, deeper - 1)


def _parts(node: ast.expr) -> list[ast.expr]:
    """Return the operands of a part of a formula, if it is allowed."""
    match node:
        # Integers from this size on have no floating-point number.
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool) and (
            abs(value) < 2**1023
        ):
            return []
        case ast.Name(id=name):
            if name not in COORDINATES and name not in CONSTANTS:
                known = [*COORDINATES, *CONSTANTS]
                raise ValueError(str(unknown_name("variable", name, known, "formula")))
            return []
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=inner):
            return [inner]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return [left, right]
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARED:
            return [left, right]
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            if name not in FUNCTIONS:
                raise ValueError(str(unknown_name("function", name, FUNCTIONS, "formula")))
            if len(arguments) != FUNCTIONS[name][1]:
                raise ValueError(f"{name}() takes {FUNCTIONS[name][1]} values in a formula")
            return arguments
    raise ValueError(f"{ast.unparse(node)[:40]!r} is not allowed in a formula")


def _value(node: ast.expr, points: Array) -> Any:  # noqa: ANN401 - numbers, or arrays of them
    match node:
        case ast.Constant(value=int() | float() as value):
            # As a floating-point number: integers would grow without bound under **.
            return np.float64(value)
        case ast.Name(id=name) if name in COORDINATES:
            axis, per_metre = COORDINATES[name]
            return per_metre * points[axis]
        case ast.Name(id=name):
            return CONSTANTS[name]
        case ast.UnaryOp(op=op, operand=inner):
            value = _value(inner, points)
            return -value if isinstance(op, ast.USub) else value
        case ast.BinOp(left=left, op=op, right=right):
            return _BINARY[type(op)](_value(left, points), _value(right, points))
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            # As numbers: booleans have no minus.
            return 1.0 * _COMPARED[type(op)](_value(left, points), _value(right, points))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return FUNCTIONS[name][0](*(_value(part, points) for part in arguments))
    raise ValueError(f"{ast.unparse(node)[:40]!r} is not allowed in a formula")
