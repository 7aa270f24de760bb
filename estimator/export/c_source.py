"""Export as self-contained C99: exact constants, tables, templates."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from estimator.export.program import Precision, Program, rounded
from thermojoint.artefacts.folders import write_folder
from thermojoint.artefacts.templates import templates_of

if TYPE_CHECKING:
    from jinja2 import Environment

#: For each precision: the C type, the suffix of its constants and of the functions of math.h.
_TYPES = {Precision.DOUBLE: ("double", ""), Precision.SINGLE: ("float", "f")}


def c_files(program: Program) -> dict[str, str]:
    """Return the text of NAME.h, NAME.c and NAME_selftest.c by file name."""
    kind = program.interface.kind
    real, f = _TYPES[program.precision]
    endings = {".h": f"{kind}.h.j2", ".c": f"{kind}.c.j2", "_selftest.c": "selftest.c.j2"}
    return program.rendered(environment(program.precision), endings, real=real, f=f)


def write_c(program: Program, folder: Path | str) -> list[Path]:
    """Write a program as C99 into a folder, replacing it as a whole.

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
    return write_folder(Path(folder), c_files(program))


def literal(value: float, precision: Precision) -> str:
    """Return a number as an exact hexadecimal C99 literal.

    Raises
    ------
    InputError
        It is not finite at that precision.
    """
    number, (_, suffix) = rounded(value, precision), _TYPES[precision]
    if number == 0.0:
        return f"0.0{suffix}"
    head, _, exponent = number.hex().partition("p")
    return f"{head.rstrip('0').rstrip('.')}p{exponent}{suffix}"


def table(values: ArrayLike, precision: Precision) -> str:
    """Return an array of any shape, real or complex, as an initialiser; complex as {re, im}."""
    array = np.asarray(values)
    if np.iscomplexobj(array):
        array = np.stack((array.real, array.imag), axis=-1)
    return _braces(array, precision)


def _braces(array: np.ndarray, precision: Precision | None) -> str:
    """Initialiser of an array; of integers if there is no precision."""
    if array.ndim == 0:
        return literal(float(array), precision) if precision else str(int(array))
    parts = [_braces(entry, precision) for entry in array]
    if array.ndim == 1:
        return "{" + ", ".join(parts) + "}"
    return "{\n" + ",\n".join(parts) + "\n}"


def environment(precision: Precision) -> Environment:
    """The templates, with ``| c`` for a number, ``| table`` for an array, ``| wide`` in double."""
    templates = templates_of("estimator.export")
    templates.filters["c"] = lambda value: literal(value, precision)
    templates.filters["table"] = lambda values: table(values, precision)
    templates.filters["integers"] = lambda values: _braces(np.asarray(values), None)
    templates.filters["wide"] = lambda values: table(values, Precision.DOUBLE)
    templates.filters["double"] = lambda value: literal(value, Precision.DOUBLE)
    return templates
