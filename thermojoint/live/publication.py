"""Publication of one machine at one instant, common to all interfaces."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np

from estimator.estimate_table import detail_name, detail_scale
from estimator.interface import Channel
from estimator.quality import Quality
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MEGA, MILLI
from thermojoint.live.next_reading import ReadingRequest

NO_REQUEST = ReadingRequest()
#: Number of values in a row before the arrays: time, published, quality.
_LEADING = 3


class AxisLine(NamedTuple):
    """An axis of the control that receives a line: K0, its offset, and a slope."""

    axis: str
    #: Reference position P0, m.
    reference: float
    #: Largest distance from P0 on the stroke, m.
    lever: float


@dataclass(frozen=True)
class Layout:
    """Names of the published values of a machine; machines of a model share one."""

    #: Axes of the displacement, without units.
    axes: tuple[str, ...]
    #: Axes of the control that receive an offset; empty without a compensation output.
    controls: tuple[str, ...]
    #: Internal signals of the estimator, in SI.
    details: tuple[Channel, ...]
    #: Readings of the machine, with units in the names: ``T1_degC``.
    readings: tuple[str, ...]
    #: Axes among `controls` that receive a slope as well.
    lines: tuple[AxisLine, ...] = ()

    @property
    def levers(self) -> Array:
        """Correction (m) per received value: 1 for offsets, the lever (m) for slopes."""
        return np.array([1.0] * len(self.controls) + [one.lever for one in self.lines])

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of the arrays in a row of the history, in the order of `Columns`."""
        named = (self.axes, self.axes, self.controls, self.lines, self.details, self.readings)
        return tuple(map(len, named))

    @property
    def width(self) -> int:
        """Number of values in a row of the history."""
        return _LEADING + sum(self.sizes)

    @property
    def meanings(self) -> tuple[Hashable, ...]:
        """What the values of a row are after the leading ones; K0 and slope belong to their P0."""
        references = {one.axis: one.reference for one in self.lines}
        return (
            *(("displacement", axis) for axis in self.axes),
            *(("band", axis) for axis in self.axes),
            *(("offset", axis, references.get(axis)) for axis in self.controls),
            *(("slope", axis, reference) for axis, reference in references.items()),
            *self.details,
            *(("reading", name) for name in self.readings),
        )


@dataclass(frozen=True, eq=False, slots=True)
class Publication:
    """Values published for one machine at one instant."""

    machine: str
    #: Number of the sample, counted from 1; 0 before the first.
    number: int
    #: Time of the sample by its source, s since 1970 (UTC); NaN before the first.
    time: float
    #: Time of publication, s since 1970 (UTC).
    published: float
    #: Quality of displacement, band and offsets.
    quality: Quality
    #: Names of the following values.
    layout: Layout
    #: Shape (axes,): m; NaN where unknown.
    displacement: Array
    band: Array
    #: Shape (controls,): offsets that the control receives, m; K0 for an axis with a slope.
    offsets: Array
    #: Shape (details,): in SI.
    details: Array
    #: Shape (readings,): in the units of their names; NaN for missing ones.
    readings: Array
    #: ``ok``, or the reasons in words, with their channels.
    status: str
    #: Mode of the offsets (`thermojoint.compensation.offsets.output.Mode`); empty without offsets,
    #: and in the history.
    offset_mode: str = ""
    #: State of the handshake with the control
    #: (`thermojoint.compensation.offsets.handshake.Handshake`); empty where there is none.
    handshake: str = ""
    #: The requested displacement reading; none in the history.
    request: ReadingRequest = NO_REQUEST
    #: Shape (lines,): slopes that the control receives, m/m.
    slopes: Array = field(default_factory=lambda: np.empty(0))


def _channels_of(status: str, reason: str) -> list[str]:
    """Return the channels concerned by a reason of a status in words."""
    for word in status.split():
        name, _, channels = word.partition(":")
        if name == reason and channels:
            return channels.split(",")
    return []


def iso_time(time: float) -> str | None:
    """Return a time (s since 1970) as ISO 8601 in UTC, to the millisecond; None if unknown."""
    if not math.isfinite(time):
        return None
    return datetime.fromtimestamp(time, UTC).isoformat(timespec="milliseconds")[:-6] + "Z"


def as_json(publication: Publication) -> dict[str, Any]:
    """Return a publication for JSON: units in the keys, null for unknown values.

    Displacement, band and offsets are in µm, rounded to a tenth of a nanometre, slopes in µm/m;
    details in SI with the unit in the name, readings in the unit of their name.
    """
    layout = publication.layout
    return {
        "machine": publication.machine,
        "number": publication.number,
        "time": iso_time(publication.time),
        "time_s": _number(publication.time),
        "published": iso_time(publication.published),
        "published_s": _number(publication.published),
        "quality": publication.quality.word,
        "status": publication.status,
        "displacement_um": micrometres(layout.axes, publication.displacement),
        "band_um": micrometres(layout.axes, publication.band),
        "offsets_um": micrometres(layout.controls, publication.offsets),
        **_lines(layout, publication.slopes),
        "offset_mode": publication.offset_mode or None,
        "handshake": publication.handshake or None,
        "next_reading": publication.request.content,
        "details": {
            detail_name(channel): _number(detail_scale(channel) * value)
            for channel, value in zip(layout.details, publication.details.tolist(), strict=True)
        },
        "readings": {
            name: _number(value)
            for name, value in zip(layout.readings, publication.readings.tolist(), strict=True)
        },
        "missing": _channels_of(publication.status, "reading-missing"),
        "distrusted": _channels_of(publication.status, "sensor-distrusted"),
    }


def _lines(layout: Layout, slopes: Array) -> dict[str, Any]:
    """Return the slopes and reference positions of the axes that have them, for JSON."""
    if not layout.lines:
        return {}
    axes = [one.axis for one in layout.lines]
    return {
        "slopes_um_per_m": micrometres(axes, slopes),
        "P0_mm": {one.axis: round(one.reference / MILLI, 6) for one in layout.lines},
    }


def micrometres(names: Iterable[str], values: Array) -> dict[str, float | None]:
    """Return lengths (m) in µm by name, to a tenth of a nanometre; None for unknown ones.

    Slopes (m/m) are likewise returned in µm/m.
    """
    numbers = (MEGA * values).tolist()
    return {
        name: round(value, 4) if math.isfinite(value) else None
        for name, value in zip(names, numbers, strict=True)
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def as_row(publication: Publication) -> Array:
    """Return the numbers of a publication as one row of the history, shape (layout.width,)."""
    return np.concatenate(
        (
            (publication.time, publication.published, float(publication.quality)),
            publication.displacement,
            publication.band,
            publication.offsets,
            publication.slopes,
            publication.details,
            publication.readings,
        )
    )


@dataclass(frozen=True)
class Columns:
    """Rows of the history by quantity; n rows, oldest first."""

    #: Shape (n,): s since 1970.
    times: Array
    published: Array
    #: Shape (n,): numbers of `Quality`.
    quality: Array
    #: Shape (n, axes): m.
    displacement: Array
    band: Array
    #: Shape (n, controls): m.
    offsets: Array
    #: Shape (n, lines): m/m.
    slopes: Array
    #: Shape (n, details): SI.
    details: Array
    #: Shape (n, readings): in the units of their names.
    readings: Array


def columns_of(layout: Layout, rows: Array) -> Columns:
    """Split rows of the history, shape (n, layout.width), by quantity."""
    parts = np.split(rows[:, _LEADING:], np.cumsum(layout.sizes)[:-1], axis=1)
    return Columns(*rows[:, :_LEADING].T, *parts)


def fitted(rows: Array, before: Layout, now: Layout) -> Array:
    """Return rows of the history of one layout in another; what it did not have is NaN."""
    if before == now:
        return rows
    places = {one: _LEADING + k for k, one in enumerate(before.meanings)}
    found = np.full((len(rows), now.width), np.nan)
    found[:, :_LEADING] = rows[:, :_LEADING]
    for k, one in enumerate(now.meanings):
        if one in places:
            found[:, _LEADING + k] = rows[:, places[one]]
    return found


def from_row(
    machine: str, number: int, layout: Layout, row: Sequence[float] | Array, status: str
) -> Publication:
    """Return the publication of a row; the inverse of `as_row`."""
    columns = columns_of(layout, np.asarray(row, dtype=float)[None, :])
    return Publication(
        machine,
        number,
        float(columns.times[0]),
        float(columns.published[0]),
        Quality(int(columns.quality[0])),
        layout,
        columns.displacement[0],
        columns.band[0],
        columns.offsets[0],
        columns.details[0],
        columns.readings[0],
        status,
        slopes=columns.slopes[0],
    )
