"""Report of a test: one self-contained HTML page, and the same figures as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from thermojoint.artefacts.figures import svg_address
from thermojoint.artefacts.templates import templates_of
from thermojoint.standards.iso230_3.evaluation import Evaluation
from thermojoint.standards.iso230_3.figure import SHOWN, figure_of
from thermojoint.standards.iso230_3.parameters import Parameter
from thermojoint.standards.iso230_3.protocol import Protocol
from thermojoint.standards.iso230_3.record import Record

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
        "parameters": [_row(parameter) for parameter in evaluation.parameters],
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
        rows=[_row(parameter) for parameter in evaluation.parameters],
        unsettled=evaluation.unsettled,
        picture=svg_address(figure_of(record, evaluation), "iso230-3"),
    )


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
