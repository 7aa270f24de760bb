"""All machines of a service: from arrivals to records and publications."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np

from estimator.quality import Quality
from thermojoint.compensation.offsets.handshake import STANDS, Answer, answered
from thermojoint.live.arrivals import Arrival
from thermojoint.live.loaded_models import LoadedModel
from thermojoint.live.log_lines import EventLog
from thermojoint.live.machine_state import (
    MachineState,
    Times,
    after_silence,
    begun_anew,
    postpone_reading,
    process_sample,
    publication_of,
    received_record,
    rest_of,
    state_bytes,
    update_handshake,
)
from thermojoint.live.metrics import Metrics
from thermojoint.live.next_reading import ReadingRequest
from thermojoint.live.publication import Publication, as_row
from thermojoint.live.samples import AssemblyRule, AssemblyStep, assemble
from thermojoint.live.settings import WatchdogSection
from thermojoint.live.store import Checkpoint, Gap, ReceivedOffsets, StoredSample

#: Arrivals that have waited for a sample for this time, s, are stored unassembled.
STALLED_S = 2.0
#: A time longer than this many intervals is a gap in the history.
_GAP = 1.5
#: Time of current readings after which the clock is believed to have been set back before the
#: service started, s: a computer without a battery is behind until the network tells it the time.
_UNSEEN_SET_BACK_S = 3600.0


@dataclass(eq=False, slots=True)
class Machine:
    """A machine in the service."""

    model: LoadedModel
    #: Number of its era in the store.
    era: int
    state: MachineState
    #: Read position of its source.
    position: Any
    #: Time of its last usable sample, by the service's own clock, s, and by the system clock, s
    #: since 1970.
    last_usable: float
    last_usable_time: float
    #: Time of its last sample, under any model, s since 1970; NaN before the first.
    last_time: float = math.nan
    #: Whether no sample has arrived since the service started.
    awaits_first_sample: bool = True
    #: Quality and status as last published.
    published_quality: tuple[Quality, str] = (Quality.BAD, "no-sample")
    #: Mode of the offsets as last published.
    published_mode: str = ""
    #: State of the handshake at the last check; empty before the first.
    handshake_state: str = ""
    #: Samples since the last checkpoint.
    rows: list[tuple[Any, str]] = field(default_factory=list)
    #: Called once the next sample is stored.
    acknowledgements: list[Callable[[], None]] = field(default_factory=list)
    #: Time of arrival of the first of them, by the service's own clock, s.
    unacknowledged_since: float = math.inf
    #: Time, by the service's own clock, since which current readings are late because the system
    #: clock was set back, s.
    set_back_since: float = math.inf


@dataclass(eq=False)
class Results:
    """Results of processing some arrivals."""

    #: To be stored in one transaction.
    samples: list[StoredSample] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    #: The newest of each machine, to be published afterwards.
    publications: dict[str, Publication] = field(default_factory=dict)
    #: Called once these samples are stored.
    acknowledgements: list[Callable[[], None]] = field(default_factory=list)
    #: Times at which the arrivals that closed them were received, s since 1970.
    receipt_times: list[float] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Fleet:
    """The machines of a service, with log and metrics."""

    #: Machines by name.
    machines: Mapping[str, Machine]
    log: EventLog
    metrics: Metrics
    #: Readings further in the future are refused, s.
    ahead: float
    #: Samples further in the past count as old, s.
    behind: float
    #: Limits of silence.
    watchdog: WatchdogSection


def process(fleet: Fleet, arrivals: Iterable[Arrival], now: float, clock: float) -> Results:
    """Run arrivals, in the order of arrival, through their estimators; the machines are updated.

    The present time is `now`, s since 1970, and `clock`, s, on the service's own monotonic clock.
    """
    results = Results()
    for arrival in arrivals:
        machine = fleet.machines.get(arrival.machine)
        if machine is None:
            continue
        step = _assembled(fleet, machine, arrival, now)
        fleet.metrics.arrivals.labels(step.verdict).inc()
        machine.position = arrival.position
        _note_set_back(fleet, machine, arrival.time, step.verdict, Times(now, clock))
        if step.verdict != "taken":
            _report_refusal(fleet, arrival, step.verdict, now)
            if arrival.acknowledge:
                results.acknowledgements.append(arrival.acknowledge)
            continue
        if not math.isnan(step.unconfirmed):
            _report_refusal(fleet, replace(arrival, time=step.unconfirmed), "ahead", now)
        machine.state = machine.state._replace(assembly=step.state)
        if arrival.acknowledge:
            if not machine.acknowledgements:
                machine.unacknowledged_since = clock
            machine.acknowledgements.append(arrival.acknowledge)
        for sample in step.samples:
            _process_sample(fleet, machine, sample, Times(now, clock), results)
        if step.samples:
            results.receipt_times.append(arrival.received_at)
            results.acknowledgements += machine.acknowledgements
            machine.acknowledgements = []
            rest = rest_of(machine.state, machine.position)
            results.samples[-1] = results.samples[-1]._replace(rest=rest)
    return results


def _assembled(fleet: Fleet, machine: Machine, arrival: Arrival, now: float) -> AssemblyStep:
    """Assign an arrival to samples; an occasional reading that is older than `behind` is late.

    It would join the next sample, whatever its time, as a displacement of then.
    """
    rule, state = machine.model.rule, machine.state.assembly
    occasional = all(value is None for value in arrival.readings[: rule.wanted])
    # Readings of a backlog are as old as its samples; NaN before the first of them.
    if occasional and age_of(rule, fleet.behind, arrival.time, min(state.last, now)) > 0.0:
        return AssemblyStep(state, [], "late")
    return assemble(rule, state, arrival.time, arrival.readings, (now, now + fleet.ahead))


def _process_sample(
    fleet: Fleet,
    machine: Machine,
    sample: tuple[float, tuple[float, ...]],
    times: Times,
    results: Results,
) -> None:
    """Process one sample of one machine."""
    instant, now = sample[0], times.now
    before, since = machine.state.latest, machine.last_time
    name, machine.last_time = machine.state.name, instant
    if instant - since > _GAP * machine.model.rule.interval:
        why = "the service was down" if machine.awaits_first_sample else "no readings"
        results.gaps.append(Gap(name, since, instant, why))
        fleet.log.say(now, "hole", f"{instant - since:.3f} s without samples: {why}", name)
    age = age_of(machine.model.rule, fleet.behind, instant, now)
    silence = silence_of(machine, times)
    if not has_reading(machine.model, machine.model.intake.usable(sample[1])):
        # A sample without any reading counts as silence, whatever its estimate.
        age = max(age, silence)
    machine.state, refusal = process_sample(
        machine.model, machine.state, sample, times, age, silence
    )
    machine.awaits_first_sample = False
    latest = machine.state.latest
    if refusal:
        fleet.log.say(now, "sample-refused", refusal, name)
    else:
        machine.last_usable, machine.last_usable_time = times.clock - age, now - age
        if latest.status != before.status and before.number:
            fleet.log.say(now, "status", f"{latest.status}, was {before.status}", name)
        _report_request(fleet, name, before.request, latest.request, now)
    row = as_row(latest)
    machine.rows.append((row, latest.status))
    results.samples.append(
        StoredSample(machine.era, latest.number, row.tobytes(), latest.status, "{}")
    )
    published = publication_of(machine.state)
    if (silence := silence_of(machine, times)) >= fleet.watchdog.uncertain_s:
        # The sample was read late: its estimate is old.
        machine.state, published = after_silence(
            machine.model, machine.state, silence, times, fleet.watchdog
        )
    machine.published_quality = published.quality, published.status
    machine.published_mode = published.offset_mode
    results.publications[name] = published
    fleet.metrics.samples.labels(machine.model.file).inc()


def silence_of(machine: Machine, times: Times) -> float:
    """Return the time since the last usable sample of a machine, s, by the clock that says more.

    The service's own clock stands still while the computer is suspended.
    """
    return max(times.clock - machine.last_usable, times.now - machine.last_usable_time)


def has_reading(model: LoadedModel, usable: Iterable[float]) -> bool:
    """Return whether usable readings (`Intake.usable`) include one expected in every sample."""
    return any(map(math.isfinite, islice(usable, model.rule.wanted)))


def _report_request(
    fleet: Fleet, name: str, before: ReadingRequest, after: ReadingRequest, now: float
) -> None:
    """Log and count a request for a displacement reading, and its outcome."""
    if (after.axis, after.since, after.outcome) == (before.axis, before.since, before.outcome):
        return
    fleet.log.say(now, "next-reading", after.text, name)
    fleet.metrics.next_readings.labels(name, after.outcome).inc()


def postpone(fleet: Fleet, name: str, now: float) -> Publication | None:
    """Postpone the requested reading of a machine; return its publication, or None if none."""
    machine = fleet.machines[name]
    before, machine.state = machine.state, postpone_reading(machine.model, machine.state)
    if machine.state is before:
        return None
    _report_request(fleet, name, before.request, machine.state.request, now)
    return publication_of(machine.state)


def _report_refusal(fleet: Fleet, arrival: Arrival, verdict: str, now: float) -> None:
    last = fleet.machines[arrival.machine].state.assembly.last
    # Until then every reading is late.
    set_back = f"; the clock was set back: the last sample is {last - now:.0f} s ahead of it"
    reasons = {
        "late": f"a reading of {arrival.time:.3f} s came after its sample was closed"
        + (set_back if last > now + fleet.ahead else ""),
        "ahead": f"a reading's time {arrival.time:.3f} s is {arrival.time - now:.0f} s ahead of "
        "the clock",
        "no-time": f"{arrival.time!r} is not a time",
    }
    fleet.log.say(now, verdict, reasons[verdict], arrival.machine)


def _note_set_back(fleet: Fleet, machine: Machine, time: float, verdict: str, times: Times) -> None:
    """Note since when current readings are late because the clock was set back."""
    if not machine.state.assembly.last > times.now + fleet.ahead:
        machine.set_back_since = math.inf
    elif verdict == "late":
        current = age_of(machine.model.rule, fleet.behind, time, times.now) == 0.0
        machine.set_back_since = min(machine.set_back_since, times.clock) if current else math.inf


def set_back_machines(fleet: Fleet, times: Times) -> list[Machine]:
    """Return the machines that have to begin anew because the clock was set back for good.

    The service has seen the step since the last usable sample of a machine, or it is believed after
    a longer time.
    """
    found = []
    for machine in fleet.machines.values():
        step = machine.last_usable_time - machine.last_usable - (times.now - times.clock)
        wait = fleet.watchdog.bad_s if step > fleet.ahead else _UNSEEN_SET_BACK_S
        if times.clock - machine.set_back_since >= wait:
            found.append(machine)
    return found


def begin_anew(fleet: Fleet, machine: Machine, era: int, now: float) -> None:
    """Let a machine take readings of the present again, in a new era, after a set-back clock."""
    state, ahead = machine.state, machine.state.assembly.last - now
    text = f"the clock was set back: the last sample is {ahead:.0f} s ahead of it; the estimator "
    fleet.log.say(now, "set-back", f"{text}starts anew, its offsets continue", state.name)
    machine.era, machine.state = era, begun_anew(machine.model, state)
    machine.set_back_since = math.inf


def age_of(rule: AssemblyRule, behind: float, instant: float, now: float) -> float:
    """Return the present age of a sample beyond the allowed delay of its source, s."""
    return max(0.0, now - instant - behind - rule.interval - rule.lateness)


def received_offsets(fleet: Fleet, names: Iterable[str], now: float) -> list[ReceivedOffsets]:
    """Return the values that some controls are about to receive, to be stored first."""
    machines = (fleet.machines[name] for name in names)
    messages = (received_record(machine.model, machine.state, now) for machine in machines)
    return [message for message in messages if message is not None]


def check_silence(fleet: Fleet, now: float, clock: float) -> list[Publication]:
    """Return the publications whose quality or offsets have changed by silence."""
    changed = []
    limits = fleet.watchdog
    for machine in fleet.machines.values():
        age, output = silence_of(machine, Times(now, clock)), machine.model.output
        oldest = math.inf if output is None else output.trust.oldest
        handshake_changed = _check_handshake(fleet, machine, now, clock)
        handshake_broken = machine.handshake_state not in ("", STANDS)
        if age < min(limits.uncertain_s, oldest) and not handshake_changed and not handshake_broken:
            continue
        before = machine.state.output
        state, latest = after_silence(machine.model, machine.state, age, Times(now, clock), limits)
        machine.state, after = state, state.output
        offsets_changed = (
            handshake_changed
            or latest.offset_mode != machine.published_mode
            or (
                before is not None
                and after is not None
                and not np.array_equal(before.steps, after.steps)
            )
        )
        if (latest.quality, latest.status) != machine.published_quality:
            since = f"for {age:.0f} s" if math.isfinite(age) else "since the clock was set back"
            fleet.log.say(
                now, "silent", f"{latest.quality.word}: no usable sample {since}", state.name
            )
        elif not offsets_changed:
            continue
        if after is not None and after is before:
            # Republished offsets count as received now: their rate is limited from here on.
            machine.state = state._replace(output=after._replace(time=clock))
        machine.published_quality = latest.quality, latest.status
        machine.published_mode = latest.offset_mode
        changed.append(latest)
    return changed


def _check_handshake(fleet: Fleet, machine: Machine, now: float, clock: float) -> bool:
    """Update the handshake of a machine; return whether it has changed since the last check."""
    model, name = machine.model, machine.state.name
    if model.handshake is None:
        return False
    machine.state = update_handshake(model, machine.state, clock)
    state, before = machine.state.handshake.state, machine.handshake_state
    machine.handshake_state = state
    if state == before:
        return False
    fleet.log.say(now, "handshake", f"{state}, was {before or 'not begun'}", name)
    return True


def receive_answer(fleet: Fleet, name: str, given: Answer, clock: float) -> None:
    """Receive an answer of a machine's control, at a time of the service's own clock (s)."""
    machine = fleet.machines[name]
    handshake = answered(machine.state.handshake, given, clock)
    machine.state = machine.state._replace(handshake=handshake)


def checkpoint_of(machine: Machine, full: bool = False) -> Checkpoint:
    """Return the checkpoint of a machine; its list of samples is empty afterwards.

    A full one is for a store without data of the machine: it has at least one sample.
    """
    latest = machine.state.latest
    if full and latest.number and not machine.rows:
        machine.rows = [(as_row(latest), latest.status)]
    rows = np.array([row for row, _ in machine.rows]).reshape(-1, machine.model.layout.width)
    status = tuple(status for _, status in machine.rows)
    machine.rows = []
    return Checkpoint(
        machine.era,
        machine.state.latest.number,
        state_bytes(machine.model, machine.state),
        rest_of(machine.state, machine.position),
        rows,
        status,
    )


def count_qualities(fleet: Fleet) -> None:
    """Count the machines by quality."""
    counts = dict.fromkeys(Quality, 0)
    for machine in fleet.machines.values():
        counts[machine.published_quality[0]] += 1
    for quality, count in counts.items():
        fleet.metrics.quality.labels(quality.word).set(count)


def last_usable_clock(last: Publication, rule: AssemblyRule, behind: float, times: Times) -> float:
    """Return the time of the last usable sample by the service's own clock; -inf if unknown.

    The age of a sample published in the future is unknown: the clock was set back meanwhile.
    """
    if last.number == 0 or not last.published <= times.now:
        return -math.inf
    age = age_of(rule, behind, last.time, last.published)
    return times.clock - (times.now - last.published) - age


def stalled_machines(fleet: Fleet, clock: float) -> list[Machine]:
    """Return the machines whose arrivals have waited for a sample for `STALLED_S` or longer.

    A broker whose messages are not acknowledged may stop sending, and then no sample is closed.
    """
    return [
        machine
        for machine in fleet.machines.values()
        if machine.acknowledgements and clock - machine.unacknowledged_since >= STALLED_S
    ]


def count_modes(fleet: Fleet, seconds: float) -> None:
    """Count how long the offsets of each machine have followed, frozen and faded."""
    for name, machine in fleet.machines.items():
        if machine.published_mode:
            fleet.metrics.modes.labels(name, machine.published_mode).inc(seconds)
