"""The paper's estimator as C: the recursion of `estimator.fchs.stream`, mode by mode."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from estimator.export import modes, recorded
from estimator.export.c_source import (
    Exported,
    Interface,
    Operations,
    Precision,
    Variable,
    checked_name,
    distinct,
    listed,
    written,
)
from estimator.fchs.estimator import Fchs
from estimator.interface import Status
from estimator.measured import LARGEST
from estimator.span import SLACK, with_slack
from models.assembly_file import fingerprint

#: The status of a sample that is left out: a bit that no estimator in Python has.
REFUSED = 1 << 15
_STATUSES = (Status.BEYOND_TIME, Status.BEYOND_HEAT, Status.BEYOND_TEMPERATURE)


class NamedBank(NamedTuple):
    """A bank as it stands in the program."""

    name: str
    modes: modes.Modes
    on_lines: bool


def export_fchs(
    estimator: Fchs,
    precision: Precision,
    name: str,
    samples: Iterable[Sequence[float]] | None = None,
    origin: str = "a day of a duty cycle",
) -> Exported:
    """Return the program of an assembled estimator.

    Parameters
    ----------
    estimator : Fchs
        Its assembly gives every coefficient.
    precision : Precision
        Of all numbers of the program.
    name : str
        Begins the names of its files and symbols.
    samples : iterable of sequences, optional
        Time, s, and readings, K, for the self-test; default: a duty cycle.
    origin : str
        Where these come from.

    Raises
    ------
    InputError
        The name is none, a sample is unusable, or a coefficient has no number of the precision.
    """
    checked_name(name)
    assembly = estimator.assembly
    channels = [channel.name for channel in estimator.channels]
    span, dt = assembly.model.span, assembly.dt_s
    if samples is None:
        samples = recorded.duty_cycle(span, channels, dt).tolist()
    kept = recorded.recorded(estimator, samples, dt, origin)
    banks = _banks(estimator)
    ranges = [*(span.temperatures[name] for name in channels), span.heat]
    values = {
        "axes": distinct(estimator.axes, "axes"),
        "statuses": [(one.name, one.value) for one in _STATUSES],
        "refused": REFUSED,
        "banks": banks,
        "limits": [with_slack(one) for one in ranges],
        "longest": (1.0 + SLACK) * span.duration_s,
        "no_temperature": LARGEST,
    }
    usual = _operations(banks)
    return written(
        _interface(estimator, name),
        precision,
        values,
        kept,
        constants=2 * len(ranges) + 2 + sum(bank.modes.numbers for bank in banks),
        state=4 * sum(bank.modes.states for bank in banks)
        + 2 * sum(bank.modes.drive.shape[1] for bank in banks if bank.on_lines)
        + len(channels)
        + 4,
        usual=usual,
        worst=usual + _another_interval(banks),
        labels=("a sample at the nominal interval", "at any other interval, at most"),
    )


def _interface(estimator: Fchs, name: str) -> Interface:
    assembly, axes = estimator.assembly, distinct(estimator.axes, "axes")
    channels = distinct([channel.name for channel in estimator.channels], "sensors")
    sensors = channels[1:]
    numbers = [str(k + 1) for k in range(len(sensors))]
    return Interface(
        name=name,
        kind="fchs",
        fingerprint=fingerprint(assembly),
        interval=assembly.dt_s,
        timed=True,
        inputs=tuple(Variable(one, "K", "") for one in channels),
        outputs=(
            *listed("displacement", "m", axes),
            Variable("heat", "1", "heat"),
            *listed("sources", "1", numbers),
            *listed("deviation", "K", sensors),
            *listed("linear", "m", axes),
            *listed("nonlinear", "m", axes),
        ),
    )


def _banks(estimator: Fchs) -> tuple[NamedBank, ...]:
    a = estimator.assembly
    return (
        NamedBank("heat", modes.on_lines(a.heat, a.dt_s), True),
        NamedBank("linear", modes.on_constants(a.linear, a.dt_s), False),
        NamedBank("temperature", modes.on_constants(a.temperature, a.dt_s), False),
        NamedBank("sources", modes.on_lines(a.sources, a.dt_s), True),
        NamedBank("nonlinear", modes.on_constants(a.nonlinear, a.dt_s), False),
    )


def _operations(banks: Sequence[NamedBank]) -> Operations:
    found = Operations(additions=9)
    for bank in banks:
        count = modes.operations_on_lines if bank.on_lines else modes.operations_on_constants
        found += count(bank.modes)
    return found


def _another_interval(banks: Sequence[NamedBank]) -> Operations:
    found = Operations()
    for bank in banks:
        found += modes.operations_of_interval(bank.modes, bank.on_lines)
    return found
