"""Export as Structured Text (IEC 61131-3): one function block and its self-test."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from estimator.export.program import Precision, Program, rounded
from thermojoint.artefacts.folders import write_folder
from thermojoint.artefacts.templates import templates_of

if TYPE_CHECKING:
    from jinja2 import Environment

#: Types of numbers in Structured Text.
_TYPES = {Precision.DOUBLE: "LREAL", Precision.SINGLE: "REAL"}
#: Numbers per line of a table.
_IN_A_LINE = 6
#: Indentation, variable and value of a loop whose bounds are the same number.
_ONE_PASS = re.compile(r"^( *)FOR (\w+) := (\d+) TO \3 DO\n", re.MULTILINE)


def st_files(program: Program) -> dict[str, str]:
    """Return the text of NAME.st and NAME_selftest.st by file name."""
    endings = {".st": f"{program.interface.kind}.st.j2", "_selftest.st": "selftest.st.j2"}
    templates = _environment(program.precision)
    files = program.rendered(templates, endings, real=_TYPES[program.precision])
    return {name: without_single_passes(text) for name, text in files.items()}


def write_structured_text(program: Program, folder: Path | str) -> list[Path]:
    """Write a program as Structured Text into a folder, replacing it as a whole.

    Parameters
    ----------
    program : Program
        From `export_program`.
    folder : Path or str
        Destination; it must be empty, missing, or contain a program of this kind.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        A coefficient is not representable at this precision, or the folder contains other files.
    """
    return write_folder(Path(folder), st_files(program))


def without_single_passes(text: str) -> str:
    """Return a program with every single-pass loop replaced by its statements.

    Some versions of matiec, the compiler of Beremiz and OpenPLC, do not run ``FOR j := 0 TO 0``.
    """
    while opening := _ONE_PASS.search(text):
        indent, variable, value = opening.groups()
        end = f"\n{indent}END_FOR;\n"
        body, _, rest = text[opening.end() :].partition(end)
        body = re.sub("^    ", "", body, flags=re.MULTILINE)
        text = f"{text[: opening.start()]}{indent}{variable} := {value};\n{body}\n{rest}"
    return text


def decimal(value: float, precision: Precision) -> str:
    """Return a decimal literal that reads back exactly, e.g. ``1.5E-7``.

    A real literal needs a decimal point, even before an exponent.

    Raises
    ------
    InputError
        It is not finite at that precision.
    """
    number = rounded(value, precision)
    text = str(np.float32(number)) if precision is Precision.SINGLE else repr(number)
    head, _, exponent = text.partition("e")
    head = head if "." in head else f"{head}.0"
    return f"{head}E{int(exponent)}" if exponent else head


def literal(value: float, precision: Precision) -> str:
    """Return a typed literal for use in expressions, so that nothing is converted implicitly."""
    text = decimal(value, precision)
    typed = f"{_TYPES[precision]}#{text.removeprefix('-')}"
    return f"(-{typed})" if text.startswith("-") else typed


def initial(values: ArrayLike, precision: Precision) -> str:
    """Return initial values of an array of any shape, real or complex: flat, last index fastest.

    PLC systems differ in how they initialise multi-dimensional arrays.
    """
    array = np.asarray(values)
    if np.iscomplexobj(array):
        array = np.stack((array.real, array.imag), axis=-1)
    return _listed([decimal(number, precision) for number in array.ravel().tolist()])


def words(values: Sequence[int]) -> str:
    """Return initial values of status words."""
    return _listed([f"WORD#16#{value:04X}" for value in values])


def _listed(flat: Sequence[str]) -> str:
    lines = [", ".join(flat[k : k + _IN_A_LINE]) for k in range(0, len(flat), _IN_A_LINE)]
    return "[" + ",\n        ".join(lines) + "]"


def numbers_in(values: ArrayLike) -> int:
    """Return the number of real numbers in an array."""
    array = np.asarray(values)
    return int(array.size * (2 if np.iscomplexobj(array) else 1))


def _environment(precision: Precision) -> Environment:
    """The templates, with ``| r`` for a number, ``| initial`` and ``| wide`` for an array."""
    templates = templates_of("estimator.export")
    templates.filters["r"] = lambda value: literal(value, precision)
    templates.filters["initial"] = lambda values: initial(values, precision)
    templates.filters["wide"] = lambda values: initial(values, Precision.DOUBLE)
    templates.filters["exact"] = lambda value: decimal(value, Precision.DOUBLE)
    templates.filters["words"] = words
    templates.filters["integers"] = lambda values: _listed(
        [str(number) for number in np.ravel(values).tolist()]
    )
    templates.filters["size"] = numbers_in
    return templates
