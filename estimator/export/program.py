"""Language-independent program of an estimator: interface, constants, test samples, costs."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, field
from enum import StrEnum
from operator import add
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.export.recorded import Recorded
from estimator.interface import Estimate, Estimator, Status
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

if TYPE_CHECKING:
    from jinja2 import Environment

#: Tolerance of the self-test: in double precision relative to the largest displacement, unless a
#: kind has its own, in single precision in m.
RELATIVE, ABSOLUTE = 1e-12, 1e-8
#: Status bits shared with the estimators in Python.
COMMON = 0xFFF
#: Status of a rejected sample: a bit that no estimator in Python has.
REFUSED = 1 << 15
#: Valid prefix of a symbol, which leaves room for the rest.
_NAME = re.compile(r"[A-Za-z](_?[A-Za-z0-9])*")
_LONGEST = 31
#: Longest remainder of a symbol: with its prefix, no symbol has more than 63 characters.
_LONGEST_PART = 48


class Precision(StrEnum):
    """Precision of every number in the exported program."""

    DOUBLE = "double"
    SINGLE = "single"

    @property
    def size(self) -> int:
        """Bytes of one number."""
        return 8 if self is Precision.DOUBLE else 4


@dataclass(frozen=True)
class Operations:
    """Operations on real numbers of one sample; a subtraction is an addition."""

    #: Functions are those of math.h: exp, sin, cos.
    multiplications: int = 0
    additions: int = 0
    divisions: int = 0
    functions: int = 0

    def __add__(self, other: Operations) -> Operations:
        return Operations(*map(add, astuple(self), astuple(other)))

    def times(self, count: int) -> Operations:
        """Return the operations of this many repetitions."""
        return Operations(*(count * own for own in astuple(self)))


def solving(size: int) -> Operations:
    """Return the operations of Gaussian elimination with this many unknowns."""
    square = size * (size - 1)
    inner = square * (2 * size - 1) // 6
    return Operations(inner + 2 * square, inner + 2 * square + size, 2 * size)


class Variable(NamedTuple):
    """Input or output of a program."""

    #: The unit in SI, ``1`` if it has none.
    name: str
    unit: str
    #: Of a reading or estimate member in C, e.g. ``displacement[0]``.
    place: str


class Table(NamedTuple):
    """An array of the program."""

    name: str
    what: str
    values: Array | NDArray[np.int64]

    @property
    def shape(self) -> str:
        """Dimensions in C notation."""
        return "".join(f"[{size}]" for size in self.values.shape)


class Compared(NamedTuple):
    """Output that the self-test compares with the estimator in Python."""

    #: The output.
    variable: Variable
    #: Factor that makes it m.
    metres: float = 1.0
    #: Status bit under which it is from an earlier sample and is not compared.
    held: int = 0


@dataclass(frozen=True)
class Interface:
    """Interface of a program."""

    #: Kind and fingerprint of the estimator.
    kind: str
    fingerprint: str
    #: Nominal, s.
    interval: float
    #: Whether other intervals are accepted.
    timed: bool
    #: Inputs, and outputs beside the status; displacements first.
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    #: Of the displacement.
    axes: tuple[str, ...]
    #: Status bits shared with the estimator in Python.
    statuses: tuple[Status, ...]
    #: Those under which the program is near the estimator in Python, but not the same.
    approximate: tuple[Status, ...] = ()
    #: Outputs that the self-test compares beside the displacements.
    lines: tuple[Compared, ...] = ()
    #: `Compared.held` of the displacements.
    held: int = 0

    @property
    def compared(self) -> tuple[Compared, ...]:
        """Outputs that the self-test compares: displacements first."""
        moved = [Compared(one, held=self.held) for one in self.outputs[: len(self.axes)]]
        return (*moved, *self.lines)


def no_lines(estimate: Estimate) -> Array:
    """Return the values of `Interface.lines` in an estimate where there are none."""
    return np.zeros(0)


@dataclass(frozen=True)
class Contents:
    """Kind-specific contents of a program."""

    #: The estimator in Python, as the reference.
    estimator: Estimator
    interface: Interface
    #: Template values specific to this kind.
    values: Mapping[str, Any]
    #: Numbers in the tables and in the state.
    constants: int
    state: int
    #: Of a typical sample, and upper bound.
    usual: Operations
    worst: Operations
    #: Descriptions of these two.
    labels: tuple[str, str]
    #: Generates time, s, and readings for a self-test if none are recorded.
    duty: Callable[[], Iterable[Sequence[float]]]
    #: Description of these readings.
    origin: str = "a day of a duty cycle"
    #: Values of `Interface.lines` in an estimate in Python, m.
    lines: Callable[[Estimate], Array] = no_lines
    #: Tolerance of the self-test in double precision, relative to the largest value compared.
    relative: float = RELATIVE


@dataclass(frozen=True)
class Program:
    """A program and its costs; `c_source` and `structured_text` write it.

    Attributes
    ----------
    name : str
        Prefix of its symbols.
    interface : Interface
        Its interface.
    precision : Precision
        Of its numbers.
    values : dict
        Template values.
    kept : Recorded
        Samples of the self-test.
    constants, state : int
        Bytes of the tables and of the state.
    usual, worst : Operations
        Of a typical sample, and upper bound.
    labels : pair of str
        Descriptions of these two.
    version : str
        Of the exporting program.
    relative : float
        As in `Contents`.
    """

    name: str
    interface: Interface
    precision: Precision
    values: Mapping[str, Any] = field(repr=False)
    kept: Recorded = field(repr=False)
    constants: int
    state: int
    usual: Operations
    worst: Operations
    labels: tuple[str, str]
    version: str
    relative: float = RELATIVE

    @property
    def samples(self) -> int:
        """Number of samples in the self-test."""
        return len(self.kept.samples)

    @property
    def common(self) -> dict[str, Any]:
        """Template values common to all kinds."""
        interface = self.interface
        return {
            "name": self.name,
            "fingerprint": interface.fingerprint,
            "dt": interface.interval,
            "timed": interface.timed,
            "inputs": interface.inputs,
            "outputs": interface.outputs,
            "channels": [variable.name for variable in interface.inputs],
            "axes": interface.axes,
            "statuses": [(status.name, status.value) for status in interface.statuses],
            "refused": REFUSED,
            "common": COMMON,
            "unsettled_bit": Status.UNSETTLED.value,
            "version": self.version,
            "precision": self.precision,
            "constants": self.constants,
            "state": self.state,
            "samples": self.kept.samples,
            "compared": interface.compared,
            "expected": self.kept.compared,
            "words": self.kept.words,
            # It is written into a comment, which a file name must not close.
            "origin": re.sub(r"[^\w .,-]", "_", self.kept.origin),
            "relative": self.precision is Precision.DOUBLE,
            "allowed": self.relative if self.precision is Precision.DOUBLE else ABSOLUTE,
            **self.values,
        }

    def rendered(
        self, templates: Environment, endings: Mapping[str, str], **words: str
    ) -> dict[str, str]:
        """Return the text of its files by their names.

        Parameters
        ----------
        templates : Environment
            With the filters of a language.
        endings : mapping of str to str
            Ending of a file's name to its template.
        words : str
            Template values beside those of the program.
        """
        return {
            f"{self.name}{ending}": templates.get_template(template).render(**self.common, **words)
            for ending, template in endings.items()
        }


def rounded(value: float, precision: Precision) -> float:
    """Return the nearest number of a precision.

    Raises
    ------
    InputError
        There is none.
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
    return number


def checked_name(name: str) -> str:
    """Return a name that is a valid symbol prefix in C and Structured Text.

    Raises
    ------
    InputError
        The name is invalid.
    """
    if not _NAME.fullmatch(name) or len(name) > _LONGEST:
        raise InputError(
            f"--name {name}: begins every symbol of the program; give a letter, then at most 30 "
            "letters, digits and single underscores"
        )
    return name


def listed(name: str, unit: str, of: Sequence[str]) -> list[Variable]:
    """Return the members of an array in the estimate."""
    return [Variable(f"{name}_{member}", unit, f"{name}[{k}]") for k, member in enumerate(of)]


def identifier(text: str) -> str:
    """Return a name as the rest of a C or Structured Text symbol, with single underscores."""
    return re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_") or "_"


def distinct(names: Sequence[str], what: str) -> tuple[str, ...]:
    """Return names as distinct symbols.

    Raises
    ------
    InputError
        Two of them become identical, or one is too long.
    """
    identifiers = tuple(map(identifier, names))
    if len({name.upper() for name in identifiers}) < len(identifiers) or "_" in identifiers:
        raise InputError(
            f"export: the {what} {', '.join(names)} are not distinct as names of a program; "
            "rename one"
        )
    if max(map(len, identifiers), default=0) > _LONGEST_PART:
        raise InputError(f"export: the {what} {', '.join(names)}: a name is too long; rename it")
    return identifiers
