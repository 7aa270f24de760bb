"""Documents of an MTConnect agent (XML, versions 1.3 to 2.x): devices, observations, errors.

ANSI/MTC1.4 and its later parts, Part 1 (protocol) and Part 2 (devices). Document type declarations
are refused, so no entity is expanded.
"""

from __future__ import annotations

import math
import re
from collections.abc import Container, Iterator, Mapping
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from thermojoint.artefacts.quantities import Place, column_named, place_of
from thermojoint.live.http_session import UnusableError
from thermojoint.live.times import seconds_of

_ROOT = re.compile(r"\{urn:mtconnect\.org:MTConnect(Devices|Streams|Error):(\d+)\.(\d+)\}(\w+)")
_OLDEST, _NEWEST = (1, 3), (2, 99)
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_UNAVAILABLE = "UNAVAILABLE"
#: Representations whose observations are single numbers.
_SINGLE = {None, "VALUE", "DISCRETE"}
#: Units of observations (Part 2, units of a data item) by the unit of a column.
_UNITS = {
    "AMPERE": "A",
    "CELSIUS": "degC",
    "DEGREE/SECOND": "deg_s",
    "MILLIMETER": "mm",
    "MILLIMETER/SECOND": "mm_s",
    "NEWTON_METER": "Nm",
    "PERCENT": "percent",
    "REVOLUTION/MINUTE": "rpm",
    "SECOND": "s",
    "WATT": "W",
}


class Header(NamedTuple):
    """Header of a document."""

    #: Changes when the agent starts anew.
    instance: int
    #: Time of creation by the agent's clock, s since 1970.
    created: float
    #: Capacity of the agent's buffer, observations.
    size: int
    #: First observation after this document; last one in the agent. -1 without.
    next: int
    last: int


class Item(NamedTuple):
    """A data item."""

    #: Unique in the agent.
    ident: str
    #: Empty without a unit.
    unit: str
    #: Whether its observations are single values.
    single: bool


class Devices(NamedTuple):
    """Devices of an agent, by name and by uuid: their data items by name and by id."""

    header: Header
    devices: Mapping[str, Mapping[str, Item]]


class Observation(NamedTuple):
    """One observation; the value is NaN if it is unavailable."""

    item: str
    sequence: int
    time: float
    value: float


class Streams(NamedTuple):
    """Observations by their sequence; `faults` describes malformed ones."""

    header: Header
    observations: tuple[Observation, ...]
    faults: tuple[str, ...] = ()


class Refused(NamedTuple):
    """Codes and texts of the errors of an agent."""

    codes: tuple[str, ...]
    text: str


class _NoEntities(ElementTree.TreeBuilder):
    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuse a document type declaration."""
        del name, pubid, system
        raise UnusableError("a document with a document type")


def document_of(content: bytes, wanted: Container[str] = ()) -> Devices | Streams | Refused:
    """Parse a document; of its observations only those of the wanted data items are returned.

    Raises
    ------
    UnusableError
        The content is not such a document, or is of another version.
    """
    try:
        parser = ElementTree.XMLParser(target=_NoEntities())
        root = ElementTree.fromstring(content, parser)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise UnusableError(f"no XML: {str(error)[:100]}") from error
    match = _ROOT.fullmatch(str(root.tag))
    if match is None:
        raise UnusableError(f"a document of another kind: {str(root.tag)[:100]}")
    version = int(match[2]), int(match[3])
    if not _OLDEST <= version <= _NEWEST:
        raise UnusableError(f"version {match[2]}.{match[3]}: only 1.3 to 2.x are read")
    if match[1] == "Error":
        errors = [one for one in root.iter() if one.get("errorCode")]
        text = "; ".join((one.text or "").strip() or one.get("errorCode", "") for one in errors)
        return Refused(tuple(one.get("errorCode", "") for one in errors), text[:200])
    header = _header(root)
    if match[1] == "Devices":
        return Devices(header, dict(_devices(root)))
    return _streams(root, header, wanted)


def _local(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _header(root: ElementTree.Element) -> Header:
    for child in root:
        if _local(child) == "Header":
            given = child.attrib
            try:
                return Header(
                    _whole(given["instanceId"]),
                    seconds_of(given["creationTime"]),
                    _whole(given.get("bufferSize", "0")),
                    _whole(given["nextSequence"]) if "nextSequence" in given else -1,
                    _whole(given["lastSequence"]) if "lastSequence" in given else -1,
                )
            except (KeyError, ValueError, OverflowError) as error:
                raise UnusableError(f"a header without {str(error)[:100]}") from error
    raise UnusableError("a document without a header")


def _whole(text: str) -> int:
    if not re.fullmatch(r"\d{1,20}", text):
        raise ValueError(f"a whole number: {text[:30]!r}")
    return int(text)


def _devices(root: ElementTree.Element) -> Iterator[tuple[str, dict[str, Item]]]:
    for device in root.iter():
        # An Agent is also a device, with the state of the agent itself.
        if _local(device) == "Device" and device.get("id"):
            found: dict[str, Item] = {}
            for one in device.iter():
                ident = one.get("id")
                if _local(one) == "DataItem" and ident and '"' not in ident:
                    single = one.get("representation") in _SINGLE
                    item = Item(ident, one.get("units", ""), single)
                    found[ident] = item
                    found.setdefault(one.get("name", ident), item)
            for name in (device.get("uuid"), device.get("name")):
                if name:
                    yield name, found


def _streams(root: ElementTree.Element, header: Header, wanted: Container[str]) -> Streams:
    if header.next < 0 or header.last < 0:
        raise UnusableError("observations without nextSequence and lastSequence")
    found: list[Observation] = []
    faults: list[str] = []
    for one in root.iter():
        item = one.get("dataItemId", "")
        if item not in wanted:
            continue
        try:
            sequence, time = _whole(one.get("sequence", "")), seconds_of(one.get("timestamp", ""))
            value = _value("".join(one.itertext()).strip())
        except (ValueError, OverflowError) as error:
            # It still is the newest observation of its item: the previous one is no longer valid.
            faults.append(f"{item}: {str(error)[:100]}")
            sequence, time, value = max(0, header.next - 1), header.created, math.nan
        found.append(Observation(item, sequence, time, value))
    found.sort(key=lambda observation: observation.sequence)
    return Streams(header, tuple(found), tuple(faults))


def _value(text: str) -> float:
    if text == _UNAVAILABLE:
        return math.nan
    if len(text) > 100 or not _NUMBER.fullmatch(text):
        raise ValueError(f"{text[:30]!r} is not a number")
    value = float(text)
    return value if math.isfinite(value) else math.nan


def conversion(item: Item, reading: str) -> Place:
    """Return the conversion of observations of a data item to a reading.

    Raises
    ------
    UnusableError
        The observations are not single values, or their unit is of another quantity than the
        reading.
    """
    if not item.single:
        raise UnusableError(f"{item.ident} has several values in one observation")
    wanted = column_named(reading)
    if wanted is None:
        return Place(0, None, None)
    unit = _UNITS.get(item.unit)
    place = None if unit is None else place_of(reading, [f"{wanted.base}_{unit}"])
    if place is None:
        raise UnusableError(f"{item.ident} is in {item.unit or 'no unit'}, which is not {reading}")
    return place


def converted(place: Place, value: float) -> float:
    """Return an observation in the unit of its reading."""
    return float(place.values(np.array([value]))[0])
