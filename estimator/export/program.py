"""An estimator as a program for a control, in any language: calls, numbers, samples, costs."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from estimator.export.recorded import Recorded, check_answerable, even, recorded
from estimator.interface import Estimator, Status
from thermojoint.artefacts.errors import InputError

#: What a self-test allows: in double precision relative to the largest displacement, in single m.
RELATIVE, ABSOLUTE = 1e-12, 1e-8
#: Bits of the status that an estimator in Python has, too.
COMMON = 0xFFF
#: The status of a sample that is left out: a bit that no estimator in Python has.
REFUSED = 1 << 15
#: What begins a name, and leaves room for the rest of it.
_NAME = re.compile(r"[A-Za-z](_?[A-Za-z0-9])*")
_LONGEST = 31
#: The rest of it; with what stands before, no name has more than 63 characters.
_LONGEST_PART = 48


class Precision(StrEnum):
    """Of every number in the exported program."""

    DOUBLE = "double"
    SINGLE = "single"

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
    """Interface of a program.

    Attributes
    ----------
    kind, fingerprint : str
        Of the estimator.
    interval : float
        Nominal, s.
    timed : bool
        Whether any other interval may follow.
    inputs, outputs : tuple of Variable
        Readings, and what it says beside its status; displacements first.
    axes : tuple of str
        Of the displacement.
    statuses : tuple of Status
        What it says as the estimator in Python does.
    """

    kind: str
    fingerprint: str
    interval: float
    timed: bool
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    axes: tuple[str, ...]
    statuses: tuple[Status, ...]


@dataclass(frozen=True)
class Contents:
    """Contents of a program.

    Attributes
    ----------
    estimator : Estimator
        What the program does, in Python, from its initial state on.
    interface : Interface
        How it is called.
    values : dict
        What its templates ask for, beside what is the same for every kind.
    constants, state : int
        Numbers in the tables and in the state.
    usual, worst : Operations
        Of a sample as they usually come, and at most.
    labels : pair of str
        What these two are of.
    duty : callable
        Gives time, s, and readings for a self-test where none are recorded.
    origin : str
        What these are.
    """

    estimator: Estimator
    interface: Interface
    values: Mapping[str, Any]
    constants: int
    state: int
    usual: Operations
    worst: Operations
    labels: tuple[str, str]
    duty: Callable[[], Iterable[Sequence[float]]]
    origin: str = "a day of a duty cycle"


@dataclass(frozen=True)
class Program:
    """A program and what it costs; `c_source` and `structured_text` write it.

    Attributes
    ----------
    name : str
        Begins its symbols.
    interface : Interface
        How it is called.
    precision : Precision
        Of its numbers.
    values : dict
        What its templates ask for.
    kept : Recorded
        Samples of the self-test.
    constants, state : int
        Bytes of the tables and of the state.
    usual, worst : Operations
        Of a sample as they usually come, and at most.
    labels : pair of str
        What these two are of.
    version : str
        Of the program that exported it.
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

    @property
    def samples(self) -> int:
        """Of the self-test."""
        return len(self.kept.samples)

    @property
    def common(self) -> dict[str, Any]:
        """What every template may ask for."""
        one = self.interface
        return {
            "name": self.name,
            "fingerprint": one.fingerprint,
            "dt": one.interval,
            "timed": one.timed,
            "inputs": one.inputs,
            "outputs": one.outputs,
            "channels": [variable.name for variable in one.inputs],
            "axes": one.axes,
            "statuses": [(status.name, status.value) for status in one.statuses],
            "refused": REFUSED,
            "common": COMMON,
            "version": self.version,
            "precision": self.precision,
            "constants": self.constants,
            "state": self.state,
            "samples": self.kept.samples,
            "expected": self.kept.displacement,
            "words": self.kept.words,
            # It stands in a comment, which no file name may end.
            "origin": re.sub(r"[^\w .,-]", "_", self.kept.origin),
            "relative": self.precision is Precision.DOUBLE,
            "allowed": RELATIVE if self.precision is Precision.DOUBLE else ABSOLUTE,
            **self.values,
        }


def program(
    contents: Contents,
    precision: Precision,
    name: str,
    samples: Iterable[Sequence[float]] | None,
    origin: str,
) -> Program:
    """Return the program of what an estimator gives.

    Parameters
    ----------
    contents : Contents
        What the estimator gives.
    precision : Precision
        Of all numbers.
    name : str
        Begins every symbol.
    samples : iterable of sequences, optional
        Time, s, and readings for the self-test; default: a duty cycle.
    origin : str
        Where they come from.

    Raises
    ------
    InputError
        The name is none, or a sample is one to which the program has no answer.
    """
    checked_name(name)
    interface = contents.interface
    if samples is None:
        samples, origin = contents.duty(), contents.origin
    if not interface.timed:
        samples = even(samples, interface.interval, origin)
    kept = recorded(contents.estimator, samples, interface.interval, origin)
    check_answerable(kept, interface.statuses)
    return Program(
        name,
        interface,
        precision,
        contents.values,
        kept,
        constants=precision.size * contents.constants,
        state=precision.size * contents.state,
        usual=contents.usual,
        worst=contents.worst,
        labels=contents.labels,
        version=version("thermojoint"),
    )


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
    """Return a name that C and Structured Text take at the beginning of every symbol.

    Raises
    ------
    InputError
        It is none.
    """
    if not _NAME.fullmatch(name) or len(name) > _LONGEST:
        raise InputError(
            f"--name {name}: begins every symbol of the program; give a letter, then at most 30 "
            "letters, digits and single underscores"
        )
    return name


def listed(name: str, unit: str, of: Sequence[str]) -> list[Variable]:
    """Return the members of an array of the estimate."""
    return [Variable(f"{name}_{one}", unit, f"{name}[{k}]") for k, one in enumerate(of)]


def identifier(text: str) -> str:
    """Return what C and Structured Text take as the rest of a name: single underscores inside."""
    return re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_") or "_"


def distinct(names: Sequence[str], what: str) -> tuple[str, ...]:
    """Return names as the program may have them.

    Raises
    ------
    InputError
        Two of them become the same, or one is too long.
    """
    found = tuple(map(identifier, names))
    if len({one.upper() for one in found}) < len(found) or "_" in found:
        raise InputError(
            f"export: the {what} {', '.join(names)} are not distinct as names of a program; "
            "rename one"
        )
    if max(map(len, found), default=0) > _LONGEST_PART:
        raise InputError(f"export: the {what} {', '.join(names)}: a name is too long; rename it")
    return found
