"""Export of an estimator of any exportable kind."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.metadata import version

from estimator.export.program import Precision, Program, checked_name
from estimator.export.recorded import check_answerable, even, recorded
from estimator.kind import OpenedEstimator
from estimator.registry import kind_of
from thermojoint.artefacts.errors import InputError, unknown_name


def export_program(
    estimator: OpenedEstimator,
    precision: Precision | str = Precision.DOUBLE,
    name: str = "thermojoint",
    samples: Iterable[Sequence[float]] | None = None,
    origin: str = "samples",
    interval: float = 2.0,
) -> Program:
    """Return an estimator's program with samples for its self-test; nothing is written.

    Parameters
    ----------
    estimator : OpenedEstimator
        Of an exportable kind: FCHS, joint-aware or learned.
    precision : Precision or str
        ``double`` or ``single``, for all numbers of the program.
    name : str
        Prefix of the file names and symbols.
    samples : iterable of sequences, optional
        Time, s, and a value for each channel, for the self-test; default: a duty cycle.
    origin : str
        Description of these samples.
    interval : float
        Nominal, s, for a learned estimator; the others have their own.

    Raises
    ------
    InputError
        The kind is not exportable, the name or the precision is invalid, a sample is unusable or
        would be judged differently by the program, or a coefficient is not representable at this
        precision.
    """
    checked_name(name)
    if precision not in list(Precision):
        raise unknown_name("precision", precision, Precision, "export")
    numbers = Precision(precision)
    kind = kind_of(estimator)
    if kind.program is None:
        raise InputError(f"export: {kind.name} has no program; run it with 'thermojoint estimate'")
    contents = kind.program(estimator, numbers, interval)
    interface = contents.interface
    if samples is None:
        samples, origin = contents.duty(), contents.origin
    if not interface.timed:
        samples = even(samples, interface.interval, origin)
    kept = recorded(contents.estimator, contents.lines, samples, interface.interval, origin)
    check_answerable(kept, [one for one in interface.statuses if one not in interface.approximate])
    return Program(
        name,
        interface,
        numbers,
        contents.values,
        kept,
        constants=numbers.size * contents.constants,
        state=numbers.size * contents.state,
        usual=contents.usual,
        worst=contents.worst,
        labels=contents.labels,
        version=version("thermojoint"),
        relative=contents.relative,
    )
