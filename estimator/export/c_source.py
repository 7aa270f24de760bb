"""What every exported estimator is written with: exact numbers, tables, templates, costs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from artefacts.errors import InputError
from estimator.export.recorded import Recorded

if TYPE_CHECKING:
    from jinja2 import Environment

#: What a self-test allows: in double precision relative to the largest displacement, in single m.
RELATIVE, ABSOLUTE = 1e-12, 1e-8
#: What begins a name of C, and leaves room for the rest of it.
_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")


class Precision(StrEnum):
    """Of every number in the exported program."""

    DOUBLE = "double"
    SINGLE = "single"

    @property
    def c_type(self) -> str:
        """The type in C."""
        return "double" if self is Precision.DOUBLE else "float"

    @property
    def suffix(self) -> str:
        """What ends a constant of the type, and the name of its functions in math.h."""
        return "" if self is Precision.DOUBLE else "f"

    @property
    def size(self) -> int:
        """Of one number, bytes."""
        return 8 if self is Precision.DOUBLE else 4


@dataclass(frozen=True)
class Operations:
    """Operations on real numbers of one sample; a subtraction is an addition.

    Attributes
    ----------
    multiplications, additions, divisions, functions : int
        Functions are those of math.h: exp, sin, cos.
    """

    multiplications: int = 0
    additions: int = 0
    divisions: int = 0
    functions: int = 0

    def __add__(self, other: Operations) -> Operations:
        return Operations(
            self.multiplications + other.multiplications,
            self.additions + other.additions,
            self.divisions + other.divisions,
            self.functions + other.functions,
        )

    def times(self, count: int) -> Operations:
        """Return those of as many repetitions."""
        return Operations(
            count * self.multiplications,
            count * self.additions,
            count * self.divisions,
            count * self.functions,
        )


class Variable(NamedTuple):
    """A number that a program takes or gives.

    Attributes
    ----------
    name, unit : str
        The unit in SI, ``1`` if it has none.
    place : str
        Of a reading or of a member of the estimate in C, e.g. ``displacement[0]``.
    """

    name: str
    unit: str
    place: str


@dataclass(frozen=True)
class Interface:
    """How a program is called.

    Attributes
    ----------
    name : str
        Begins its symbols.
    kind, fingerprint : str
        Of the estimator.
    interval : float
        Nominal, s.
    timed : bool
        Whether any other interval may follow.
    inputs, outputs : tuple of Variable
        Readings, and what it says beside its status.
    """

    name: str
    kind: str
    fingerprint: str
    interval: float
    timed: bool
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]


@dataclass(frozen=True)
class Exported:
    """A program and what it costs.

    Attributes
    ----------
    files : dict of str to str
        Name to text.
    constants, state : int
        Bytes of the tables and of the state.
    usual, worst : Operations
        Of a sample as they usually come, and at most.
    labels : pair of str
        What these two are of.
    samples : int
        Of the self-test.
    interface : Interface
        How it is called.
    precision : Precision
        Of its numbers.
    version : str
        Of the program that exported it.
    """

    files: dict[str, str] = field(repr=False)
    constants: int
    state: int
    usual: Operations
    worst: Operations
    labels: tuple[str, str]
    samples: int
    interface: Interface
    precision: Precision
    version: str


def literal(value: float, precision: Precision) -> str:
    """Return a number as C99 reads it, to the last bit: in hexadecimal.

    Raises
    ------
    InputError
        It is not finite at that precision.
    """
    number = float(value)
    if precision is Precision.SINGLE:
        with np.errstate(over="ignore"):
            number = float(np.float32(number))
    if not np.isfinite(number):
        raise InputError(
            f"export: the constant {value:g} has no {precision} precision number; export with "
            "--precision double"
        )
    if number == 0.0:
        return f"0.0{precision.suffix}"
    head, _, exponent = number.hex().partition("p")
    return f"{head.rstrip('0').rstrip('.')}p{exponent}{precision.suffix}"


def table(values: ArrayLike, precision: Precision) -> str:
    """Return an array of any shape, real or complex, as an initialiser; complex as {re, im}."""
    array = np.asarray(values)
    if np.iscomplexobj(array):
        array = np.stack((array.real, array.imag), axis=-1)
    return _braces(array, precision)


def _braces(array: np.ndarray, precision: Precision) -> str:
    if array.ndim == 0:
        return literal(float(array), precision)
    parts = [_braces(one, precision) for one in array]
    if array.ndim == 1:
        return "{" + ", ".join(parts) + "}"
    return "{\n" + ",\n".join(parts) + "\n}"


def checked_name(name: str) -> str:
    """Return a name that C takes at the beginning of every symbol.

    Raises
    ------
    InputError
        It is none.
    """
    if not _IDENTIFIER.fullmatch(name):
        raise InputError(
            f"--name {name}: begins every symbol of the program; give a letter, then at most 30 "
            "letters, digits and underscores"
        )
    return name


def written(
    interface: Interface,
    precision: Precision,
    values: Mapping[str, Any],
    kept: Recorded,
    *,
    constants: int,
    state: int,
    usual: Operations,
    worst: Operations,
    labels: tuple[str, str],
) -> Exported:
    """Return the program of an estimator.

    Parameters
    ----------
    interface : Interface
        Its kind is that of the templates: KIND.h.j2 and KIND.c.j2.
    precision : Precision
        Of its numbers.
    values : mapping
        What the templates ask for, beside what is the same for every kind.
    kept : Recorded
        For the self-test.
    constants, state : int
        Numbers in the tables and in the state.
    usual, worst, labels
        As in `Exported`.
    """
    double, name, kind = precision is Precision.DOUBLE, interface.name, interface.kind
    common: dict[str, Any] = {
        "name": name,
        "fingerprint": interface.fingerprint,
        "dt": interface.interval,
        "timed": interface.timed,
        "channels": [one.name for one in interface.inputs],
        "version": version("thermojoint"),
        "precision": precision,
        "real": precision.c_type,
        "f": precision.suffix,
        "constants": precision.size * constants,
        "state": precision.size * state,
        "samples": kept.samples,
        "expected": kept.displacement,
        "words": kept.words,
        # It stands in a comment, which no file name may end.
        "origin": re.sub(r"[^\w .,()-]", "_", kept.origin),
        "relative": double,
        "allowed": RELATIVE if double else ABSOLUTE,
    }
    templates = environment(precision)
    sources = {".h": f"{kind}.h.j2", ".c": f"{kind}.c.j2", "_selftest.c": "selftest.c.j2"}
    return Exported(
        files={
            f"{name}{ending}": templates.get_template(template).render(**common, **values)
            for ending, template in sources.items()
        },
        constants=precision.size * constants,
        state=precision.size * state,
        usual=usual,
        worst=worst,
        labels=labels,
        samples=len(kept.samples),
        interface=interface,
        precision=precision,
        version=common["version"],
    )


def listed(name: str, unit: str, of: Sequence[str]) -> list[Variable]:
    """Return the members of an array of the estimate."""
    return [Variable(f"{name}_{one}", unit, f"{name}[{k}]") for k, one in enumerate(of)]


def c_name(text: str) -> str:
    """Return a name as C may have it: what is no letter, digit or underscore becomes one."""
    return re.sub(r"[^A-Za-z0-9_]", "_", text)


def distinct(names: Sequence[str], what: str) -> tuple[str, ...]:
    """Return names as C may have them.

    Raises
    ------
    InputError
        Two of them become the same.
    """
    found = tuple(map(c_name, names))
    if len({one.upper() for one in found}) < len(found):
        raise InputError(
            f"export: the {what} {', '.join(names)} are not distinct as names in C; rename one"
        )
    return found


def environment(precision: Precision) -> Environment:
    """The templates, with ``| c`` for a number, ``| table`` for an array, ``| wide`` in double."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    found = Environment(
        loader=PackageLoader("estimator.export"),
        # C, no HTML: quotes stay quotes.
        autoescape=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )

    def c(value: float) -> str:
        return literal(value, precision)

    def as_table(values: Any) -> str:  # noqa: ANN401
        return table(values, precision)

    found.filters["c"] = c
    found.filters["table"] = as_table
    found.filters["wide"] = lambda values: table(values, Precision.DOUBLE)
    return found
