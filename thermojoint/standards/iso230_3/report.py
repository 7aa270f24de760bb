"""Report of a test: one self-contained HTML page, and the same figures as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from thermojoint.artefacts.figures import svg_address
from thermojoint.artefacts.templates import templates_of
from thermojoint.standards.iso230_3.evaluation import Evaluation
from thermojoint.standards.iso230_3.figure import SHOWN, figure_of
from thermojoint.standards.iso230_3.parameters import Parameter
from thermojoint.standards.iso230_3.protocol import Protocol
from thermojoint.standards.iso230_3.record import Record
from thermojoint.standards.iso230_3.uncertainty import COVERAGE, Uncertainty

SCHEMA, SCHEMA_VERSION = "thermojoint-iso230-3", 1


def parameters_json(evaluation: Evaluation, origin: str) -> dict[str, Any]:
    """Return the parameters for a JSON file, units in the names of the keys."""
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "test": str(evaluation.protocol),
        "origin": origin,
        "begin_s": evaluation.period.begin,
        "end_s": evaluation.period.end,
        "parameters": _rows(evaluation),
        "last_60_min_over_first": evaluation.unsettled,
    }


def report_html(
    record: Record, evaluation: Evaluation, origin: str, facts: Sequence[tuple[str, str]] = ()
) -> str:
    """Return the page, escaped, without references to other files.

    `facts` are further lines about the test, e.g. the distance of two sensors.
    """
    environment = templates_of("thermojoint.standards.iso230_3")
    return environment.get_template("report.html.j2").render(
        title=evaluation.protocol.heading,
        generator="iso230-3",
        moves=evaluation.protocol is not Protocol.ETVE,
        facts=[("record", origin), *facts],
        period=evaluation.period,
        rows=_rows(evaluation),
        bases=bases(_rows(evaluation)),
        unsettled=evaluation.unsettled,
        picture=svg_address(figure_of(record, evaluation), "iso230-3"),
    )


def bases(rows: Iterable[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return each source of uncertainty of some parameters with its basis, once."""
    told = [
        (one["source"], one["basis"])
        for row in rows
        if row["uncertainty"] is not None
        for one in row["uncertainty"]["contributions"]
    ]
    return list(dict.fromkeys(told))


def _rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    return [
        _row(parameter) | {"uncertainty": _budget(parameter, evaluation.uncertainties)}
        for parameter in evaluation.parameters
    ]


def _budget(parameter: Parameter, known: Mapping[str, Uncertainty]) -> dict[str, Any] | None:
    """Uncertainty of a parameter in its own unit."""
    if (found := known.get(parameter.symbol)) is None:
        return None
    factor, _, _ = SHOWN[parameter.quantity]
    return {
        "contributions": [
            {"source": one.source, "standard": factor * one.standard, "basis": one.basis}
            for one in found.contributions
        ],
        "combined": factor * found.combined,
        "coverage_factor": COVERAGE,
        "expanded": factor * found.expanded,
    }


def _row(parameter: Parameter) -> dict[str, Any]:
    factor, unit, _ = SHOWN[parameter.quantity]
    return {
        "symbol": parameter.symbol,
        "quantity": parameter.quantity,
        "channel": parameter.channel,
        "value": factor * parameter.value,
        "unit": unit,
        "begin_s": parameter.period.begin,
        "end_s": parameter.period.end,
        "lowest": factor * parameter.extremes.low,
        "lowest_at_s": parameter.extremes.low_at,
        "highest": factor * parameter.extremes.high,
        "highest_at_s": parameter.extremes.high_at,
    }
