"""The program of an estimator of any kind that has one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from estimator.export.program import Precision, Program, checked_name, program
from estimator.kind import OpenedEstimator
from estimator.registry import kind_of
from thermojoint.artefacts.errors import InputError


def export_program(
    estimator: OpenedEstimator,
    precision: Precision | str = Precision.DOUBLE,
    name: str = "thermojoint",
    samples: Iterable[Sequence[float]] | None = None,
    origin: str = "samples",
    interval: float = 2.0,
) -> Program:
    """Return the program of an estimator, with samples for its self-test; nothing is written.

    Parameters
    ----------
    estimator : OpenedEstimator
        Of a kind that has a program: FCHS, joint-aware and learned.
    precision : Precision or str
        ``double`` or ``single``, of all numbers of the program.
    name : str
        Begins the names of its files and symbols.
    samples : iterable of sequences, optional
        Time, s, and a value for each channel, for the self-test; default: a duty cycle.
    origin : str
        Where these come from.
    interval : float
        Nominal, s, of a learned estimator; the others have their own.

    Raises
    ------
    InputError
        The estimator is of a kind that has no program, the name is none, a sample is unusable or
        one that the program judges otherwise, or a coefficient has no number of the precision.
    """
    checked_name(name)
    numbers = Precision(precision)
    kind = kind_of(estimator)
    if kind.program is None:
        raise InputError(f"export: {kind.name} has no program; run it with 'thermojoint estimate'")
    contents = kind.program(estimator, numbers, interval)
    return program(contents, numbers, name, samples, origin)
