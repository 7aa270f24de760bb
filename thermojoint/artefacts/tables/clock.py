"""Clocks of tables: seconds to years, dates of three orders, zones, midnights and summer time."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from itertools import pairwise
from typing import NamedTuple
from zoneinfo import ZoneInfo

from thermojoint.artefacts.date_orders import ORDERS, WEEK
from thermojoint.artefacts.quantities import UNITS, column_named
from thermojoint.artefacts.tables.cells import number_in

#: Readable forms of time, for error messages.
FORMS = (
    "seconds, ms, minutes or hours by the column's unit, seconds or ms since 1970, Excel days, "
    "2026-03-02T06:00:00Z, 02.03.2026 06:00:00, 3/2/2026 6:00 AM, or 06:00:00"
)
_WORDS = frozenset(
    (
        *("time", "t", "timestamp", "time stamp", "datetime", "date time", "date/time", "date"),
        *("zeit", "zeitstempel", "zeitpunkt", "uhrzeit", "datum", "datum uhrzeit", "datum/uhrzeit"),
        *("datum/zeit", "local time", "elapsed", "elapsed time", "laufzeit"),
    )
)
_BRACKETS = re.compile(r"\s*[\[(](?P<inside>[^\])]*)[\])]\s*$")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
#: Day 0 of a spreadsheet, in days before 1970.
_EXCEL = 25_569
_DAY, _HOUR = 86_400.0, 3_600.0
#: Ranges of numbers without a unit: s, ms and µs since 1970, days since 1900.
_SECONDS, _MILLISECONDS, _MICROSECONDS = (3e8, 5e9), (3e11, 5e12), (3e14, 5e15)
_DAYS = (20_000.0, 80_000.0)
#: Latest time of a log, s: later ones are damaged or in another unit.
LATEST = _SECONDS[1]
#: Time zone abbreviations to their offset, h.
_OFFSETS = {
    name: hours
    for hours, names in {
        0.0: ("Z", "UTC", "GMT", "WET"),
        1.0: ("WEST", "BST", "CET", "MEZ"),
        2.0: ("CEST", "MESZ", "EET"),
        3.0: ("EEST",),
        9.0: ("JST",),
        -4.0: ("EDT",),
        -5.0: ("EST", "CDT"),
        -6.0: ("CST", "MDT"),
        -7.0: ("MST", "PDT"),
        -8.0: ("PST",),
    }.items()
    for name in names
}
_STAMP = re.compile(
    r"^(?:(?P<a>\d{1,4})(?P<sign>[-./])(?P<b>\d{1,2})(?P=sign)(?P<c>\d{2,4})\.?)?[T,;\s]*"
    r"(?:(?P<hour>\d{1,3}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,:](?P<part>\d{1,9}))?)?"
    r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?)?"
    r"(?:\s*Uhr)?\s*(?P<zone>(?:UTC|GMT)?[+-]\d{1,2}(?::?\d{2})?|[A-Za-z][A-Za-z_+/-]*)?$"
)


def clock_word(name: str) -> bool:
    """Whether a column's name, with or without unit or time zone, denotes a clock."""
    column = column_named(name.strip())
    if column is not None:
        return column.quantity == "time" and column.base.lower() in _WORDS
    return _BRACKETS.sub("", name).strip().lower() in _WORDS


def tells_date(seconds: float) -> bool:
    """Whether a number of seconds is so large that it must count from 1970."""
    return _SECONDS[0] < seconds < _SECONDS[1]


@dataclass(frozen=True)
class Clock:
    """Representation of time in a table."""

    #: Indices; two for a date and a time of day.
    columns: tuple[int, ...]
    #: ``number``, ``excel``, ``stamp`` or ``time of day``.
    form: str
    #: Whether times are s since 1970.
    dated: bool = False
    #: A number times `factor` / `divisor` is in s.
    factor: float = 1.0
    divisor: float = 1.0
    #: Order of a date, a key of `ORDERS`; empty if the year comes first with four digits.
    order: str = ""
    #: Other orders that fit the dates of the first rows as well.
    other_orders: tuple[str, ...] = ()
    #: Time zone of cells without one; None if it is unknown: they are taken as UTC.
    zone: tzinfo | None = None
    #: Whether it shows a local time in an unknown zone.
    local: bool = False

    @property
    def shown(self) -> str:
        """Description for reports."""
        order = f", {ORDERS[self.order]}" if self.order else ""
        return {
            "stamp": f"date and time{order}{f', {self.zone}' if self.zone else ''}",
            "excel": "days of a spreadsheet",
            "time of day": "time of day",
        }.get(self.form, "since 1970" if self.dated else "from its own start")


class Moment(NamedTuple):
    """A time, s; `second` is the later one where the end of summer time repeats a local time."""

    first: float
    second: float
    local: bool = False


class Hands(NamedTuple):
    """State of a clock between two rows."""

    #: Time of the previous row, s.
    last: float = -float("inf")
    #: Sum of the shifts by midnights and changes of summer time, s.
    shift: float = 0.0
    #: Interval before the previous row, s.
    step: float = float("inf")


def clock_of(
    names: Sequence[str], rows: Sequence[Sequence[str]], decimal: str, chosen: Sequence[int] = ()
) -> tuple[Clock | None, str]:
    """Return the clock of a table, and the mistake in a column that is named like one.

    `rows` are the first rows, at least one; `chosen` are the columns that the user named as clock.

    Notes
    -----
    A clock with a date is preferred to one that counts from a start, and that to a time of day.
    """
    named = list(chosen) or [k for k, name in enumerate(names) if clock_word(name)]
    clocks: dict[str, list[tuple[int, Clock]]] = {}
    bad = ""
    for k in named:
        cells = [row[k] for row in rows if k < len(row) and row[k].strip()]
        clock = _clock_in(k, names[k], cells, decimal)
        if clock is None:
            cell = cells[0].strip() if cells else ""
            bad = bad or f"{names[k]} is {cell!r}, which is no known form of time; write {FORMS}"
        else:
            clocks.setdefault(clock.form, []).append((k, clock))
    for form in ("stamp", "excel"):
        if form in clocks:
            return clocks[form][0][1], ""
    if "date" in clocks and "time of day" in clocks:
        (first, date), (second, day) = clocks["date"][0], clocks["time of day"][0]
        zone, local = date.zone or day.zone, date.local and day.local
        return replace(date, columns=(first, second), form="stamp", zone=zone, local=local), ""
    for form in ("number", "time of day"):
        if form in clocks:
            dated = [clock for _, clock in clocks[form] if clock.dated]
            return (dated or [clock for _, clock in clocks[form]])[0], ""
    if "date" in clocks:
        bad = f"{names[clocks['date'][0][0]]} is a date without a time of day; write {FORMS}"
    return None, bad


def _clock_in(index: int, name: str, cells: Sequence[str], decimal: str) -> Clock | None:
    """Return the clock in one column; its form is ``date`` without a time of day."""
    column = column_named(name)
    if column is not None and column.quantity == "time":
        scale = UNITS[column.unit].scale
        first = number_in(cells[0], decimal) if cells else 0.0
        if first is not None:
            dated = tells_date(scale * first)
            number = Clock((index,), "number", dated)
            # 1e-3 is not a binary fraction: ms are divided by 1000.
            return replace(number, divisor=1e3) if scale < 1.0 else replace(number, factor=scale)
    if not cells:
        return None
    values = [value for cell in cells if (value := number_in(cell, decimal)) is not None]
    if number_in(cells[0], decimal) is not None:
        return _plain_number(index, values)
    # Cells that do not fit the first one are refused when their row is read.
    parts = [match for cell in cells if (match := _STAMP.match(cell.strip()))]
    if not _STAMP.match(cells[0].strip()) or not (parts[0]["a"] or parts[0]["hour"]):
        return None
    inside = _BRACKETS.search(name)
    zone = zone_named(inside["inside"]) if inside else None
    with_time = any(part["hour"] for part in parts)
    form = ("stamp" if with_time else "date") if parts[0]["a"] else "time of day"
    order, *others = _orders([part for part in parts if part["a"]])
    local = zone is None and not any(part["zone"] for part in parts)
    dated = form != "time of day"
    return Clock(
        (index,), form, dated, order=order, other_orders=tuple(others), zone=zone, local=local
    )


def _plain_number(index: int, values: Sequence[float]) -> Clock | None:
    """Return the clock of numbers without a unit, by their size."""
    least, most = min(values), max(values)
    for (low, high), divisor in ((_SECONDS, 1.0), (_MILLISECONDS, 1e3), (_MICROSECONDS, 1e6)):
        if low < least and most < high:
            return Clock((index,), "number", dated=True, divisor=divisor)
    if _DAYS[0] < least and most < _DAYS[1] and most - least < len(values):
        return Clock((index,), "excel", dated=True, local=True)
    return None


def _orders(parts: Sequence[re.Match[str]]) -> list[str]:
    """Return the order of dates, and the others that fit them as well.

    Usual are the day first with dots and dashes, the month first with slashes. The order in which
    the least time passes is taken, as days change before months, and months before years.
    """
    if not parts or len(parts[0]["a"]) == 4:
        return [""]
    slashed = any(part["sign"] == "/" for part in parts)
    halves = any(part["half"] for part in parts)
    usual = ["mdy", "dmy"][: 1 if halves else 2] if slashed else ["dmy"]
    if all(len(part["a"]) == len(part["c"]) == 2 for part in parts):
        usual.append("ymd")
    faults = {order: _faults(parts, order) for order in usual}
    order = min(usual, key=lambda order: faults[order])
    return [order, *(one for one in usual if one != order and faults[one][:3] == (0, 0, 0))]


def _faults(parts: Sequence[re.Match[str]], order: str) -> tuple[int, int, int, float]:
    """Return how many dates do not exist, go back, and come after weeks, and the days in all."""
    dates = [_date(part, order) for part in parts]
    days = [date.toordinal() for date in dates if date is not None]
    steps = [after - before for before, after in pairwise(days)]
    back, far = sum(step < 0 for step in steps), sum(step * _DAY > WEEK for step in steps)
    return len(dates) - len(days), back, far, max(days, default=0) - min(days, default=0)


def zone_named(text: str) -> tzinfo | None:
    """Return a zone by its name (``Europe/Berlin``), abbreviation (``MEZ``) or offset; or None."""
    text = text.strip()
    if text.upper() in _OFFSETS:
        return timezone(timedelta(hours=_OFFSETS[text.upper()]), text.upper())
    offset = re.fullmatch(r"(?:UTC|GMT)?([+-])(\d{1,2})(?::?(\d{2}))?", text)
    if offset:
        size = timedelta(hours=int(offset[2]), minutes=int(offset[3] or 0))
        if size >= timedelta(days=1):
            return None
        return timezone(-size if offset[1] == "-" else size)
    if "/" not in text:
        return None
    try:
        return ZoneInfo(text)
    except (KeyError, ValueError, OSError):
        return None


def moment(clock: Clock, cells: Sequence[str], decimal: str) -> Moment | None:
    """Return the time in the cells of one row, or None if they contain none."""
    if clock.form in ("number", "excel"):
        value = number_in(cells[0], decimal)
        if value is None:
            return None
        if clock.form == "excel":
            # In double precision days are accurate to a microsecond; spreadsheets show ms.
            value = round((value - _EXCEL) * _DAY * 1e3) / 1e3
        else:
            value = value * clock.factor / clock.divisor
        return Moment(value, value)
    text = " ".join(cells).strip()
    if clock.form == "time of day":
        return _time_of_day(text)
    if text[4:5] == "-" and (text[-1:].isdigit() or text[-1:] == "Z"):
        try:
            return _seconds(datetime.fromisoformat(text), clock.zone)
        except ValueError:
            pass
    match = _STAMP.match(text)
    if match is None or not match["a"]:
        return None
    zone = clock.zone
    if match["zone"]:
        zone = zone_named(match["zone"])
        if zone is None:
            return None
    time = _time_of_day(match)
    day = _date(match, clock.order)
    if time is None or day is None:
        return None
    return _seconds(day + timedelta(microseconds=round(1e6 * time.first)), zone)


def _seconds(at: datetime, zone: tzinfo | None) -> Moment:
    local = at.tzinfo is None and zone is None
    if at.tzinfo is None:
        at = at.replace(tzinfo=zone or UTC)
    first = (at - _EPOCH).total_seconds()
    if isinstance(at.tzinfo, ZoneInfo):
        return Moment(first, (at.replace(fold=1) - _EPOCH).total_seconds())
    return Moment(first, first, local)


def _time_of_day(text: str | re.Match[str]) -> Moment | None:
    """Return the time since midnight, s."""
    match = _STAMP.match(text) if isinstance(text, str) else text
    if match is None or (isinstance(text, str) and (match["a"] or not match["hour"])):
        return None
    if not match["hour"]:
        return Moment(0.0, 0.0)
    hour, minute, second = (int(match[part] or 0) for part in ("hour", "minute", "second"))
    if match["half"]:
        hour = hour % 12 + (12 if match["half"].lower() == "p" else 0)
    # Without a date it may be the time since the start, 30:00:00.
    of_day = bool(match["a"] or match["half"])
    if (hour > 23 and of_day) or minute > 59 or second > 59:
        return None
    part = round(int(match["part"]) * 10.0 ** (6 - len(match["part"]))) if match["part"] else 0
    value = (1_000_000 * (_HOUR * hour + 60.0 * minute + second) + part) / 1e6
    return Moment(value, value)


def _date(match: re.Match[str], order: str) -> datetime | None:
    a, b, c = match["a"], match["b"], match["c"]
    if len(a) == 4 or order == "ymd":
        year, month, day = a, b, c
    elif match["sign"] == "/" and order == "mdy":
        month, day, year = a, b, c
    else:
        day, month, year = a, b, c
    try:
        return datetime(int(year) + (2000 if len(year) == 2 else 0), int(month), int(day))
    except ValueError:
        return None


def in_order(clock: Clock, order: str) -> Clock:
    """Return a clock with another order of its dates, if they leave it open; else as it is."""
    if order not in clock.other_orders:
        return clock
    others = [clock.order, *(other for other in clock.other_orders if other != order)]
    return replace(clock, order=order, other_orders=tuple(others))


def by_other_orders(clock: Clock, cells: Sequence[str], decimal: str) -> dict[str, float]:
    """Return the time in the cells of one row, s, by each other order that fits its date."""
    times = {
        order: moment(replace(clock, order=order), cells, decimal) for order in clock.other_orders
    }
    return {order: at.first for order, at in times.items() if at is not None}


def passed(clock: Clock, hands: Hands, at: Moment) -> tuple[Hands, str]:
    """Return the state of a clock at the next row, and a note on a shift, if any.

    A clock set back for an unknown reason is not corrected: the caller refuses it or starts a new
    run.
    """
    time, shift, note = at.first + hands.shift, hands.shift, ""
    # With samples about an hour apart, the end of summer time repeats a time.
    repeated = time == hands.last and _HOUR <= 1.5 * hands.step < float("inf")
    if time < hands.last or repeated:
        if at.second + shift > hands.last and at.second > at.first:
            time = at.second + shift
        elif clock.form == "time of day" and hands.last - time > 0.5 * _DAY:
            time, shift, note = time + _DAY, shift + _DAY, "midnight passed"
        elif at.local and 0.0 < time + _HOUR - hands.last <= _near(hands) and _changes(at, "end"):
            time, shift, note = time + _HOUR, shift + _HOUR, "summer time ended"
    elif at.local and _goes_on(time - _HOUR, hands) and _changes(at, "begin"):
        time, shift, note = time - _HOUR, shift - _HOUR, "summer time began"
    elif at.local and _as_before(time + _HOUR, hands) and _changes(at, "end"):
        time, shift, note = time + _HOUR, shift + _HOUR, "summer time ended"
    step = time - hands.last if hands.last > -float("inf") else hands.step
    return Hands(time, shift, step if step > 0.0 else hands.step), note


def _goes_on(time: float, hands: Hands) -> bool:
    """Whether a time (s), corrected for a clock set forward, fits the previous step better."""
    step, half = time - hands.last, 0.5 * _HOUR
    nearer = math.isinf(hands.step) or hands.step < step + half
    return (nearer and 0.0 < step <= min(1.5 * hands.step, half)) or _as_before(time, hands)


def _as_before(time: float, hands: Hands) -> bool:
    """Whether the step from the previous row to a time (s) equals the step before it."""
    return abs(time - hands.last - hands.step) < 0.1 * hands.step


def _near(hands: Hands) -> float:
    """Return the longest interval to the next row after the clock was set back, s."""
    return max(0.5 * _HOUR, 1.5 * min(hands.step, _HOUR))


def _changes(at: Moment, which: str) -> bool:
    """Whether summer time starts or ends near a local time, in Europe or America."""
    day = _EPOCH + timedelta(seconds=at.first)
    if day.isoweekday() != 7 or not 0.9 < day.hour + day.minute / 60.0 < 4.6:
        return False
    if which == "end":
        return (day.month == 10 and day.day >= 25) or (day.month == 11 and day.day <= 7)
    return day.month == 3 and (day.day >= 25 or 8 <= day.day <= 14)
