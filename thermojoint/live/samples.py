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
OpenSample = tuple[float, tuple[float | None, ...]]
#: Times before 1970 or after 2200 are refused.
LATEST_TIME = 7.3e9
#: The phase of the instants is rounded to this part of an interval.
_PARTS = 16.0


class AssemblyRule(NamedTuple):
    """Rules for assembling samples."""

    #: Interval of the instants, s.
    interval: float
    #: Allowed delay of a reading, in the source's time, s.
    lateness: float
    #: Time for which a value stays valid without a new one, s.
    hold: float
    #: Number of readings, the first ones, that complete a sample; further ones are occasional.
    wanted: int


class AssemblyState(NamedTuple):
    """Readings not yet assigned to a sample."""

    #: Instant of the last sample, s; NaN before the first.
    last: float = math.nan
    #: Latest time of a reading, s; -inf before the first.
    newest: float = -math.inf
    #: Open samples, oldest first.
    open_samples: tuple[OpenSample, ...] = ()
    #: Time and last value of each reading; empty if none is held.
    held: tuple[tuple[float, float], ...] = ()
    #: Offset of the instants from multiples of the interval, s; NaN before the first reading.
    phase: float = math.nan
    #: Latest time of an occasional reading, s; -inf before the first.
    last_occasional: float = -math.inf
    #: Time and readings from the future, which count once another reading confirms them.
    unconfirmed: OpenSample | None = None


class AssemblyStep(NamedTuple):
    """Result of arriving readings."""

    state: AssemblyState
    #: Instant and readings of every closed sample; NaN for missing readings.
    samples: list[tuple[float, tuple[float, ...]]]
    #: ``taken``, ``late`` (its sample is closed), ``ahead`` (later than the limit), ``no-time``.
    verdict: str
    #: Time of an unconfirmed reading from the future that is dropped, s; NaN for none.
    unconfirmed: float = math.nan


def phase_of(rule: AssemblyRule, time: float) -> float:
    """Return the phase (s) of instants that begin at a time.

    It is a multiple of a sixteenth of the interval: the difference of two instants then equals, to
    the last bit, the interval for which an estimator has its coefficients.
    """
    part = time / rule.interval - math.floor(time / rule.interval)
    return math.floor(_PARTS * part + 0.5) / _PARTS * rule.interval


def instant_of(rule: AssemblyRule, phase: float, time: float) -> float:
    """Return the instant (s) that a time belongs to."""
    return math.floor((time - phase) / rule.interval + 0.5) * rule.interval + phase


def assemble(
    rule: AssemblyRule,
    state: AssemblyState,
    time: float,
    readings: Readings,
    clock: tuple[float, float] = (math.inf, math.inf),
) -> AssemblyStep:
    """Assign the readings of one time, s since 1970 by the source's clock, to samples.

    A reading from the future closes no sample until a second one confirms its time: a single wrong
    time would otherwise block all readings until then. `clock` is the present time, and the latest
    accepted time, s.
    """
    now, limit = clock
    if not 0.0 <= time <= LATEST_TIME:
        return AssemblyStep(state, [], "no-time")
    if time > limit:
        return AssemblyStep(state, [], "ahead")
    if time > max(now, state.newest) + 2.0 * rule.interval + rule.lateness:
        return _await_confirmation(rule, state, time, readings, limit)
    if state.unconfirmed is not None:
        step = assemble(rule, state._replace(unconfirmed=None), time, readings, clock)
        return step._replace(unconfirmed=state.unconfirmed[0])
    phase = phase_of(rule, time) if math.isnan(state.phase) else state.phase
    instant = instant_of(rule, phase, time)
    last_occasional = state.last_occasional
    if all(value is None for value in readings[: rule.wanted]):
        if time <= last_occasional:
            return AssemblyStep(state, [], "late")
        last_occasional = time
        if not math.isnan(state.last):
            # An occasional reading joins the next sample.
            instant = max(instant, instant_of(rule, phase, state.last + rule.interval))
    if instant <= state.last:
        return AssemblyStep(state, [], "late")
    open_samples = _merged(state.open_samples, instant, tuple(readings))
    last, held, newest = state.last, state.held, max(state.newest, time)
    samples = []
    while open_samples and _is_complete(rule, last, newest, *open_samples[0]):
        (last, values), *rest = open_samples
        open_samples = tuple(rest)
        if rule.hold > 0.0:
            values, held = _with_held_values(rule, held, last, values)
        samples.append((last, tuple(math.nan if value is None else value for value in values)))
    return AssemblyStep(
        AssemblyState(last, newest, open_samples, held, phase, last_occasional), samples, "taken"
    )


def _await_confirmation(
    rule: AssemblyRule, state: AssemblyState, time: float, readings: Readings, limit: float
) -> AssemblyStep:
    """Set a reading from the future aside, or accept it together with the previous one."""
    before, rest = state.unconfirmed, state._replace(unconfirmed=None)
    if before is None or time < before[0] - 0.5 * rule.interval:
        return AssemblyStep(state._replace(unconfirmed=(time, tuple(readings))), [], "taken")
    first = assemble(rule, rest, *before, (math.inf, limit))
    second = assemble(rule, first.state, time, readings, (math.inf, limit))
    return second._replace(samples=first.samples + second.samples)


def _merged(
    open_samples: tuple[OpenSample, ...], instant: float, readings: tuple[float | None, ...]
) -> tuple[OpenSample, ...]:
    """Return the open samples with readings added to one; of a repeated reading the last counts."""
    if not open_samples:  # as usual
        return ((instant, readings),)
    merged = dict(open_samples)
    before = merged.get(instant, readings)
    merged[instant] = tuple(b if a is None else a for a, b in zip(readings, before, strict=True))
    return tuple(sorted(merged.items()))


def _is_complete(
    rule: AssemblyRule, last: float, newest: float, instant: float, values: tuple[float | None, ...]
) -> bool:
    """Return whether the oldest open sample is complete, or its readings are overdue."""
    half = 0.5 * rule.interval
    if newest >= instant + half + rule.lateness:
        return True
    if None in values[: rule.wanted]:
        return False
    # It is complete, but readings of an older one may still be in transit.
    return (
        rule.lateness <= 0.0
        or math.isnan(last)
        or instant - last <= 3.0 * half
        or newest >= instant - half + rule.lateness
    )


def _with_held_values(
    rule: AssemblyRule,
    held: tuple[tuple[float, float], ...],
    instant: float,
    values: tuple[float | None, ...],
) -> tuple[tuple[float | None, ...], tuple[tuple[float, float], ...]]:
    """Return readings completed by held values, and the values held afterwards."""
    before = held or ((-math.inf, math.nan),) * len(values)
    filled = tuple(
        last_value if value is None and k < rule.wanted and instant - since <= rule.hold else value
        for k, (value, (since, last_value)) in enumerate(zip(values, before, strict=True))
    )
    after = tuple(
        old if value is None else (instant, value)
        for value, old in zip(values, before, strict=True)
    )
    return filled, after
