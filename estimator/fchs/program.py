"""Export of the paper's estimator: the recursion of `estimator.fchs.stream`, mode by mode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from estimator.export import modes
from estimator.export.program import Contents, Interface, Operations, Variable, distinct, listed
from estimator.export.recorded import duty_cycle
from estimator.fchs.estimator import Fchs
from estimator.interface import Status
from estimator.span import SLACK, with_slack
from thermojoint.artefacts.tables.cells import LARGEST_TEMPERATURE
from thermojoint.models.assembly_file import fingerprint

_STATUSES = (
    Status.BEYOND_TIME,
    Status.BEYOND_HEAT,
    Status.BEYOND_TEMPERATURE,
    Status.UNSETTLED,
)


class NamedBank(NamedTuple):
    """A bank and its name in the program."""

    name: str
    modes: modes.Modes
    on_lines: bool


def contents(estimator: Fchs) -> Contents:
    """Return the program contents of an assembled estimator."""
    assembly = estimator.assembly
    channels = [channel.name for channel in estimator.channels]
    span, dt = assembly.model.span, assembly.dt_s
    banks = _banks(estimator)
    ranges = [*(span.temperatures[name] for name in channels), span.heat]
    usual, settling = _operations(banks), estimator.settling
    return Contents(
        estimator,
        _interface(estimator),
        values={
            "banks": banks,
            "limits": [with_slack(limits) for limits in ranges],
            "longest": (1.0 + SLACK) * span.duration_s,
            "no_temperature": LARGEST_TEMPERATURE,
            "cold": list(settling.cold.values()),
            "settling": settling.duration,
            "longest_pause": settling.longest_pause,
        },
        constants=2 * len(ranges) + len(channels) + 3 + sum(bank.modes.numbers for bank in banks),
        state=4 * sum(bank.modes.states for bank in banks)
        + 2 * sum(bank.modes.drive.shape[1] for bank in banks if bank.on_lines)
        + len(channels)
        + 5,
        usual=usual,
        worst=usual + _another_interval(banks) + Operations(additions=1),
        labels=("a sample at the nominal interval", "at any other interval, at most"),
        duty=lambda: duty_cycle([span.temperatures[name] for name in channels], dt).tolist(),
    )


def _interface(estimator: Fchs) -> Interface:
    assembly, axes = estimator.assembly, distinct(estimator.axes, "axes")
    channels = distinct([channel.name for channel in estimator.channels], "sensors")
    sensors = channels[1:]
    numbers = [str(k + 1) for k in range(len(sensors))]
    return Interface(
        kind="fchs",
        fingerprint=fingerprint(assembly),
        interval=assembly.dt_s,
        timed=True,
        inputs=tuple(Variable(channel, "K", "") for channel in channels),
        outputs=(
            *listed("displacement", "m", axes),
            Variable("heat", "1", "heat"),
            *listed("sources", "1", numbers),
            *listed("deviation", "K", sensors),
            *listed("linear", "m", axes),
            *listed("nonlinear", "m", axes),
        ),
        axes=axes,
        statuses=_STATUSES,
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
    operations = Operations(additions=9)
    for bank in banks:
        count = modes.operations_on_lines if bank.on_lines else modes.operations_on_constants
        operations += count(bank.modes)
    return operations


def _another_interval(banks: Sequence[NamedBank]) -> Operations:
    operations = Operations()
    for bank in banks:
        operations += modes.operations_of_interval(bank.modes, bank.on_lines)
    return operations
