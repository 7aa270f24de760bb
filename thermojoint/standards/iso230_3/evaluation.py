"""Evaluation of the record of a test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from thermojoint.artefacts.errors import InputError
from thermojoint.standards.iso230_3.instruments import Instruments
from thermojoint.standards.iso230_3.parameters import Parameter, distortion, environment, unsettled
from thermojoint.standards.iso230_3.period import Period, asked_for, running, whole
from thermojoint.standards.iso230_3.protocol import Protocol
from thermojoint.standards.iso230_3.record import Record
from thermojoint.standards.iso230_3.uncertainty import Uncertainty, uncertainty


@dataclass(frozen=True)
class Evaluation:
    """Result of evaluating a record."""

    protocol: Protocol
    #: Parameters of the test.
    period: Period
    parameters: tuple[Parameter, ...]
    #: Channel to range over the last 60 min, relative to the first 60 min; empty for ETVE.
    unsettled: dict[str, float]
    #: Symbol of a parameter to its uncertainty; empty if the instruments are not described.
    uncertainties: Mapping[str, Uncertainty] = field(default_factory=dict)


def evaluate(
    protocol: Protocol, record: Record, begin: float | None = None, end: float | None = None
) -> Evaluation:
    """Return the parameters of a test.

    Parameters
    ----------
    protocol : Protocol
        The recorded test.
    record : Record
    begin, end : float, optional
        Start and end of the running period, s. Default: from the first to the last motion of the
        drive; without a drive the whole record. ETVE uses the whole record.

    Raises
    ------
    InputError
        The record does not cover the test, the drive that defines the running period is ambiguous,
        or a period is given for ETVE.
    """
    if protocol is Protocol.ETVE:
        if begin is not None or end is not None:
            raise InputError("etve: is evaluated over the whole record; cut the record instead")
        return Evaluation(protocol, whole(record), environment(record), {})
    usual = _usual(record) if begin is None or end is None else whole(record)
    period = asked_for(record, usual, begin, end)
    return Evaluation(protocol, period, distortion(record, period), unsettled(record, period))


def _usual(record: Record) -> Period:
    """Return the running period by the drive; without one the whole record."""
    if record.drives:
        raise InputError(
            f"log: {', '.join(record.drives)}: name the one that runs in the test with --speed, or "
            "give the period"
        )
    return whole(record) if record.drive is None else running(record.times, record.drive)


def with_uncertainties(
    evaluation: Evaluation, record: Record, instruments: Instruments
) -> Evaluation:
    """Return an evaluation with the uncertainty of every measured parameter.

    Raises
    ------
    InputError
        The holder's thermometer is missing in the record, or was not read over a period.
    """
    found = {one.symbol: uncertainty(record, one, instruments) for one in evaluation.parameters}
    return replace(
        evaluation,
        uncertainties={symbol: one for symbol, one in found.items() if one is not None},
    )
