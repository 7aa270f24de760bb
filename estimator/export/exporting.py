"""The program of an estimator of any kind that has one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from estimator.export import fchs, joint_aware, learned
from estimator.export.program import Contents, Precision, Program, checked_name, program
from estimator.fchs.estimator import Fchs
from estimator.interface import Estimator
from estimator.joint_aware.estimator import JointAware
from estimator.learned.estimator import Learned
from thermojoint.artefacts.errors import InputError


def export_program(
    estimator: Estimator,
    precision: Precision | str = Precision.DOUBLE,
    name: str = "thermojoint",
    samples: Iterable[Sequence[float]] | None = None,
    origin: str = "samples",
    interval: float = 2.0,
) -> Program:
    """Return the program of an estimator, with samples for its self-test; nothing is written.

    Parameters
    ----------
    estimator : Estimator
        Of the kinds FCHS, joint-aware and learned.
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
    return program(_contents(estimator, numbers, interval), numbers, name, samples, origin)


def _contents(estimator: Estimator, precision: Precision, interval: float) -> Contents:
    if isinstance(estimator, Fchs):
        return fchs.contents(estimator)
    if isinstance(estimator, JointAware):
        return joint_aware.contents(estimator, precision)
    if isinstance(estimator, Learned):
        return learned.contents(estimator, interval)
    raise InputError(
        f"export: an estimator of kind {estimator.kind} has no program; run it with "
        "'thermojoint estimate'"
    )
