"""Variables of the OPC UA server with units and status codes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from estimator.estimate_table import detail_name, detail_scale
from estimator.interface import SILENT
from estimator.quality import Quality, reasons_of
from thermojoint.artefacts.quantities import column_named
from thermojoint.artefacts.units import MEGA, MILLI
from thermojoint.compensation.offsets.output import Mode
from thermojoint.live.publication import Layout, Publication
from thermojoint.live.quality import REFUSED

_CODES = ua.StatusCodes
#: Units of details, which are published in micrometres, and of readings in their own units.
_SHOWN = {"m": "µm", "m/m": "µm/m"}
_READ = {"um": "µm", "degC": "°C", "degF": "°F", "deg_s": "°/s"}

#: Function of a publication that returns a value and its status code.
Value = Callable[[Publication], tuple[Any, int]]


@dataclass(frozen=True)
class Variable:
    """One variable of a machine."""

    #: ``Displacement``, ``x``; the folder is empty for variables outside the folders.
    folder: str
    name: str
    #: Unit as displayed; empty for none.
    unit: str
    kind: ua.VariantType
    #: Value from a publication.
    value: Value
    #: Whether operators may write it.
    writable: bool = False


def status_of(publication: Publication) -> int:
    """Return the OPC UA status code of the displacement in a publication."""
    reasons = reasons_of(publication.status)
    if publication.quality is Quality.GOOD:
        return int(_CODES.Good)
    if publication.quality is Quality.BAD:
        if publication.number == 0:
            return int(_CODES.BadWaitingForInitialData)
        silent = SILENT in reasons
        return int(_CODES.BadNoCommunication if silent else _CODES.BadSensorFailure)
    if reasons & {SILENT, REFUSED}:
        return int(_CODES.UncertainLastUsableValue)
    if reasons & {"reading-missing", "sensor-distrusted"}:
        return int(_CODES.UncertainSubNormal)
    if "unsettled" in reasons:
        return int(_CODES.UncertainInitialValue)
    return int(_CODES.UncertainEngineeringUnitsExceeded)


def offset_status_of(publication: Publication) -> int:
    """Return the status code of an offset: good only while a usable estimate supports it.

    The value is always the offset that the control should apply, even while it freezes or decays.
    """
    if publication.offset_mode == Mode.FOLLOW.value:
        return int(_CODES.Good)
    if publication.offset_mode == Mode.WAIT.value or publication.number == 0:
        return int(_CODES.UncertainInitialValue)
    return int(_CODES.UncertainLastUsableValue)


def reading_status_of(publication: Publication) -> int:
    """Return the status code of a reading, which depends on its age only."""
    if publication.number == 0:
        return int(_CODES.BadWaitingForInitialData)
    if SILENT not in reasons_of(publication.status):
        return int(_CODES.Good)
    if publication.quality is Quality.BAD:
        return int(_CODES.BadNoCommunication)
    return int(_CODES.UncertainLastUsableValue)


def data_value(
    kind: ua.VariantType,
    value: Any,  # noqa: ANN401
    code: int,
    publication: Publication,
) -> ua.DataValue:
    """Return a value with its status and the time of its sample; null if it is bad."""
    if isinstance(value, float) and not math.isfinite(value):
        code = code if code & 0x80000000 else int(_CODES.BadNoData)
    bad = bool(code & 0x80000000)
    return ua.DataValue(
        Value=ua.Variant(None, ua.VariantType.Null) if bad else ua.Variant(value, kind),
        StatusCode=ua.StatusCode(code),
        SourceTimestamp=_utc(publication.time),
        ServerTimestamp=_utc(publication.published),
    )


def _utc(seconds: float) -> datetime | None:
    return datetime.fromtimestamp(seconds, UTC) if math.isfinite(seconds) else None


def variables_of(layout: Layout, readings: bool, wanted: int) -> Iterator[Variable]:
    """Yield the variables of a machine.

    The first `wanted` readings are in every sample, and have variables if `readings` is true;
    further ones are written by operators.
    """
    double, text = ua.VariantType.Double, ua.VariantType.String
    for k, name in enumerate(layout.axes):
        yield Variable("Displacement", name, "µm", double, _entry("displacement", k, MEGA))
        yield Variable("Band", name, "µm", double, _entry("band", k, MEGA))
    for k, name in enumerate(layout.controls):
        offset = _entry("offsets", k, MEGA, offset_status_of)
        yield Variable("Offset", name, "µm", double, offset)
    for k, line in enumerate(layout.lines):
        slope, reference = _entry("slopes", k, MEGA, offset_status_of), line.reference / MILLI
        yield Variable("Slope", line.axis, "µm/m", double, slope)
        yield Variable("Reference", line.axis, "mm", double, _always(reference))
    for k, channel in enumerate(layout.details):
        unit = _SHOWN.get(channel.unit, channel.unit)
        scale = detail_scale(channel)
        yield Variable("Detail", detail_name(channel), unit, double, _entry("details", k, scale))
    for k, name in enumerate(layout.readings[:wanted]):
        if readings:
            yield Variable("Reading", name, unit_of(name), double, _reading(k))
    for k, name in enumerate(layout.readings[wanted:]):
        yield Variable("Probe", name, unit_of(name), double, _reading(wanted + k), writable=True)
    yield Variable("", "Status", "", text, _good(lambda p: p.status))
    yield Variable("", "Handshake", "", text, _good(lambda p: p.handshake))
    yield Variable("", "Quality", "", text, _good(lambda p: p.quality.word))
    yield Variable("", "NextReading", "", text, _good(lambda p: p.request.axis))
    yield Variable("", "SampleNumber", "", ua.VariantType.UInt64, _good(lambda p: p.number))


def unit_of(reading: str) -> str:
    """Return the unit in the name of a reading as displayed; empty for none."""
    column = column_named(reading)
    return _READ.get(column.unit, column.unit.replace("_", "/")) if column else ""


def _entry(
    part: str, k: int, scale: float, status: Callable[[Publication], int] = status_of
) -> Value:
    return lambda p: (scale * float(getattr(p, part)[k]), status(p))


def _reading(k: int) -> Value:
    return _entry("readings", k, 1.0, reading_status_of)


def _always(value: float) -> Value:
    return lambda p: (value, int(_CODES.Good))


def _good(value: Callable[[Publication], Any]) -> Value:
    return lambda p: (value(p), int(_CODES.Good))
