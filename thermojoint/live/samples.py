"""Assembly of arriving readings into samples at the estimator's instants, in order.

Instants are one interval apart, starting at the first reading (to a sixteenth of the interval), so
that a source with jitter misses none. A reading belongs to the nearest instant. A sample is closed
as soon as it has all its readings and no older sample is open, or when a reading arrives that is
later by half an interval plus the allowed lateness. Readings that have not arrived by then are
missing, unless their last value is still held. Occasional readings, such as those of a touch probe,
join the next sample. The result depends on the arriving readings and their order but not on a
clock: the same stream gives the same samples whenever it is read.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

#: Readings of a machine at one time: None if not delivered, NaN if reported as missing.
Readings = Sequence[float | None]
#: Instant and readings of an open sample.
Cell = tuple[float, tuple[float | None, ...]]
#: Times before 1970 or after 2200 are refused.
LATEST = 7.3e9
#: The phase of the instants is rounded to this part of an interval.
_PARTS = 16.0


class Rule(NamedTuple):
    """Rules for assembling samples."""

    #: Interval of the instants, s.
    interval: float
    #: Allowed delay of a reading, in the source's time, s.
    lateness: float
    #: Time for which a value stays valid without a new one, s.
    hold: float
    #: Number of readings, the first ones, that complete a sample; further ones are occasional.
    wanted: int


class Waiting(NamedTuple):
    """Readings not yet assigned to a sample."""

    #: Instant of the last sample, s; NaN before the first.
    last: float = math.nan
    #: Latest time of a reading, s; -inf before the first.
    newest: float = -math.inf
    #: Open samples, oldest first.
    cells: tuple[Cell, ...] = ()
    #: Time and last value of each reading; empty if none is held.
    held: tuple[tuple[float, float], ...] = ()
    #: Offset of the instants from multiples of the interval, s; NaN before the first reading.
    phase: float = math.nan
    #: Latest time of an occasional reading, s; -inf before the first.
    probed: float = -math.inf
    #: Time and readings from the future, which count once another reading confirms them.
    doubted: Cell | None = None


class Arrived(NamedTuple):
    """Result of arriving readings."""

    #: State after them.
    waiting: Waiting
    #: Instant and readings of every closed sample; NaN for missing readings.
    samples: list[tuple[float, tuple[float, ...]]]
    #: ``taken``, ``late`` (its sample is closed), ``ahead`` (later than the limit), ``no-time``.
    verdict: str
    #: Time of an unconfirmed reading from the future that is dropped, s; NaN for none.
    doubted: float = math.nan


def phase_of(rule: Rule, time: float) -> float:
    """Return the phase (s) of instants that begin at a time.

    It is a multiple of a sixteenth of the interval: the difference of two instants then equals, to
    the last bit, the interval for which an estimator has its coefficients.
    """
    part = time / rule.interval - math.floor(time / rule.interval)
    return math.floor(_PARTS * part + 0.5) / _PARTS * rule.interval


def instant_of(rule: Rule, phase: float, time: float) -> float:
    """Return the instant (s) that a time belongs to."""
    return math.floor((time - phase) / rule.interval + 0.5) * rule.interval + phase


def arrived(
    rule: Rule,
    waiting: Waiting,
    time: float,
    readings: Readings,
    clock: tuple[float, float] = (math.inf, math.inf),
) -> Arrived:
    """Assign the readings of one time to samples.

    A reading from the future closes no sample until a second one confirms its time: a single wrong
    time would otherwise block all readings until then.

    Parameters
    ----------
    rule : Rule
    waiting : Waiting
        State before them.
    time : float
        Time by the source's clock, s since 1970.
    readings : sequence of float or None
        One value for each reading.
    clock : (float, float)
        The present time, and the latest accepted time, s.
    """
    now, limit = clock
    if not 0.0 <= time <= LATEST:
        return Arrived(waiting, [], "no-time")
    if time > limit:
        return Arrived(waiting, [], "ahead")
    if time > max(now, waiting.newest) + 2.0 * rule.interval + rule.lateness:
        return _doubted(rule, waiting, time, readings, limit)
    if waiting.doubted is not None:
        step = arrived(rule, waiting._replace(doubted=None), time, readings, clock)
        return step._replace(doubted=waiting.doubted[0])
    phase = phase_of(rule, time) if math.isnan(waiting.phase) else waiting.phase
    instant = instant_of(rule, phase, time)
    probed = waiting.probed
    if all(value is None for value in readings[: rule.wanted]):
        if time <= probed:
            return Arrived(waiting, [], "late")
        probed = time
        if not math.isnan(waiting.last):
            # An occasional reading joins the next sample.
            instant = max(instant, instant_of(rule, phase, waiting.last + rule.interval))
    if instant <= waiting.last:
        return Arrived(waiting, [], "late")
    cells = _merged(waiting.cells, instant, tuple(readings))
    last, held, newest = waiting.last, waiting.held, max(waiting.newest, time)
    samples = []
    while cells and _closes(rule, last, newest, *cells[0]):
        (last, values), *rest = cells
        cells = tuple(rest)
        if rule.hold > 0.0:
            values, held = _filled(rule, held, last, values)
        samples.append((last, tuple(math.nan if value is None else value for value in values)))
    return Arrived(Waiting(last, newest, cells, held, phase, probed), samples, "taken")


def _doubted(
    rule: Rule, waiting: Waiting, time: float, readings: Readings, limit: float
) -> Arrived:
    """Set a reading from the future aside, or accept it together with the previous one."""
    before, rest = waiting.doubted, waiting._replace(doubted=None)
    if before is None or time < before[0] - 0.5 * rule.interval:
        return Arrived(waiting._replace(doubted=(time, tuple(readings))), [], "taken")
    first = arrived(rule, rest, *before, (math.inf, limit))
    second = arrived(rule, first.waiting, time, readings, (math.inf, limit))
    return second._replace(samples=first.samples + second.samples)


def _merged(
    cells: tuple[Cell, ...], instant: float, readings: tuple[float | None, ...]
) -> tuple[Cell, ...]:
    """Return the cells with readings added to one; of a repeated reading the last counts."""
    if not cells:  # as usual
        return ((instant, readings),)
    merged = dict(cells)
    before = merged.get(instant, readings)
    merged[instant] = tuple(b if a is None else a for a, b in zip(readings, before, strict=True))
    return tuple(sorted(merged.items()))


def _closes(
    rule: Rule, last: float, newest: float, instant: float, values: tuple[float | None, ...]
) -> bool:
    """Return whether the oldest cell is complete, or its readings are overdue."""
    half = 0.5 * rule.interval
    if newest >= instant + half + rule.lateness:
        return True
    if None in values[: rule.wanted]:
        return False
    # The cell is complete, but readings of an older one may still be in transit.
    return (
        rule.lateness <= 0.0
        or math.isnan(last)
        or instant - last <= 3.0 * half
        or newest >= instant - half + rule.lateness
    )


def _filled(
    rule: Rule,
    held: tuple[tuple[float, float], ...],
    instant: float,
    values: tuple[float | None, ...],
) -> tuple[tuple[float | None, ...], tuple[tuple[float, float], ...]]:
    """Return readings completed by held values, and the values held afterwards."""
    before = held or ((-math.inf, math.nan),) * len(values)
    filled = tuple(
        kept if value is None and k < rule.wanted and instant - since <= rule.hold else value
        for k, (value, (since, kept)) in enumerate(zip(values, before, strict=True))
    )
    after = tuple(
        old if value is None else (instant, value)
        for value, old in zip(values, before, strict=True)
    )
    return filled, after
