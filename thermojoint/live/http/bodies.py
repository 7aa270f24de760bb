"""JSON bodies of responses: units in the keys, null for unknown values."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimator.estimate_table import detail_name, detail_scale
from estimator.quality import Quality
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MEGA, MILLI
from thermojoint.live.archive import History
from thermojoint.live.http.backend import MachineInfo
from thermojoint.live.publication import Publication, iso_time, micrometres
from thermojoint.live.store import Event


def encoded(body: Any) -> bytes:  # noqa: ANN401
    """Return JSON; NaN and infinity are errors."""
    return json.dumps(body, allow_nan=False, separators=(",", ":"), ensure_ascii=False).encode()


def summary(publication: Publication) -> dict[str, Any]:
    """Return the part of a publication for an overview, with the same names."""
    axes = publication.layout.axes
    return {
        "machine": publication.machine,
        "time_s": _rounded(publication.time, 3),
        "published_s": _rounded(publication.published, 3),
        "quality": publication.quality.word,
        "status": publication.status,
        "displacement_um": micrometres(axes, publication.displacement),
        "band_um": micrometres(axes, publication.band),
    }


@dataclass(frozen=True, eq=False)
class Messages:
    """Messages of publications, formatted once for all listeners."""

    #: Publication to the content of its message.
    body: Callable[[Publication], dict[str, Any]]
    #: Machine to its newest publication and its message.
    cached: dict[str, tuple[Publication, bytes]] = field(default_factory=dict)

    def __call__(self, publication: Publication) -> bytes:
        """Return a publication as JSON."""
        before = self.cached.get(publication.machine)
        if before is not None and before[0] is publication:
            return before[1]
        message = encoded(self.body(publication))
        self.cached[publication.machine] = (publication, message)
        return message


def machine_body(machine: str, about: MachineInfo, offers: Collection[str]) -> dict[str, Any]:
    """Return the constant data of a machine, and its further addresses."""
    layout = about.layout
    references = {line.axis: line.reference / MILLI for line in layout.lines}
    return {
        "machine": machine,
        "kind": about.kind,
        "model": about.model,
        "since": iso_time(about.since),
        "since_s": about.since,
        "axes": list(layout.axes),
        "controls": list(layout.controls),
        **({"P0_mm": references} if references else {}),
        "details": [detail_name(channel) for channel in layout.details],
        "readings": list(layout.readings),
        "valid": [span._asdict() for span in about.valid],
        "offers": sorted(offers),
    }


def history_body(machine: str, history: History) -> dict[str, Any]:
    """Return a history as columns, by name."""
    layout, columns = history.layout, history.columns
    details = [detail_name(channel) for channel in layout.details]
    lines = [line.axis for line in layout.lines]
    in_micro = np.array([detail_scale(channel) for channel in layout.details])
    return {
        "machine": machine,
        "every": history.every,
        "holes": [
            {"since_s": gap.since, "until_s": gap.until, "why": gap.why} for gap in history.gaps
        ],
        "time_s": _numbers(columns.times, 3),
        "quality": [Quality(int(quality)).word for quality in columns.quality],
        "displacement_um": _named(layout.axes, MEGA * columns.displacement),
        "band_um": _named(layout.axes, MEGA * columns.band),
        "offsets_um": _named(layout.controls, MEGA * columns.offsets),
        **({"slopes_um_per_m": _named(lines, MEGA * columns.slopes)} if lines else {}),
        "details": _named(details, columns.details * in_micro),
        "readings": _named(layout.readings, columns.readings),
    }


def events_body(events: Sequence[Event]) -> dict[str, Any]:
    """Return events, newest first."""
    return {
        "events": [
            {
                "time": iso_time(event.time),
                "time_s": event.time,
                "machine": event.machine,
                "kind": event.kind,
                "text": event.text,
            }
            for event in events
        ]
    }


def _named(names: Iterable[str], values: Array) -> dict[str, list[float | None]]:
    return {name: _numbers(column, 4) for name, column in zip(names, values.T, strict=True)}


def _numbers(values: Array, digits: int) -> list[float | None]:
    """Return a rounded column; half a picometre or a tenth of a millikelvin is noise."""
    return [_rounded(number, digits) for number in values.tolist()]


def _rounded(value: float, digits: int) -> float | None:
    return round(value, digits) if math.isfinite(value) else None
