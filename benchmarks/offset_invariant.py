"""What a control receives never jumps and never lies, whatever happens to readings and service.

python -m benchmarks.offset_invariant --sequences 10000

Random sequences (hypothesis) of samples, silences, missing and refused readings, backlogs, clock
steps, kills at every moment of a commit, restarts, other settings, axes and models, and controls
that leave, return, clear their offsets or acknowledge wrong ones drive the parts of a service as
they are, with a time that is made up. After each publication:

- every offset has moved from what the control received last by no more than the rate times the time
  since then, and a step (and half a step where a restart changed the resolution);
- it is not beyond the largest offset, unless a limit that was lowered is still on its way;
- both hold at every position of the stroke where an axis receives a slope, too;
- its status is Good only if the last estimate is usable and not too old, and the control, where a
  handshake is asked for, has enabled it and given a sign of life.

A control that is sent another P0 takes it over with its offset and slope; where a handshake is
asked for, it does so before it answers, while its machine stands.

A control that was away takes over offsets again when the handshake stands; what counts as received
last is then what it acknowledged.
"""

from __future__ import annotations

import json
import math
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from asyncua import ua
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

from benchmarks.study import options_of
from estimator.intake import of_columns
from estimator.interface import Channel, Estimate, Status
from estimator.lines import Stroke, channels_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.compensation.offsets.handshake import STANDS, Answer, HandshakeSettings
from thermojoint.compensation.offsets.output import Limits
from thermojoint.compensation.offsets.settings import Settings, settings_from_data, with_slopes
from thermojoint.live import processing
from thermojoint.live.arrivals import Arrival
from thermojoint.live.loaded_models import LoadedModel, lines_in
from thermojoint.live.log_lines import EventLog
from thermojoint.live.machine_state import Times
from thermojoint.live.metrics import fresh_metrics
from thermojoint.live.opcua_values import offset_status_of
from thermojoint.live.processing import Fleet
from thermojoint.live.publication import Layout, Publication
from thermojoint.live.running import restored_fleet
from thermojoint.live.samples import AssemblyRule
from thermojoint.live.settings import Service, service_from_data
from thermojoint.live.store import Batch, commit, new_era, open_store

START = 1_772_431_200.0
MACHINE = "mill"
INTERVAL = 1.0
#: Readings of a sample: a temperature, and what the estimator makes of it.
SOUND, REFUSED, UNSETTLED, WIDE, LOST = range(5)
_METRICS = fresh_metrics()
#: Where the displacement x is known.
STROKE = Stroke(0.3, 0.1, 0.6)
#: Of the slope of an axis that takes none.
ZERO = Limits(1.0, 0.0, 0.0, 0.0)
#: With a control that answers every second.
_SECTION = {"by": "mqtt", "differs_um": 1.0}
HANDSHAKE = HandshakeSettings(oldest=5.0, differs=1e-6, differs_time=5.0)


class Gauge:
    """An estimator whose displacement is its first reading: it does what a sequence asks for."""

    kind = "gauge"
    axes = ("x", "y")
    channels = (Channel("T1", "K"), Channel("T2", "K"))
    details = channels_of("x")

    def __init__(self, gain: float) -> None:
        self.gain = gain

    def initial_state(self) -> Array:
        """Nothing but a time."""
        return np.array([math.nan])

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Return what the second reading asks for."""
        value, what = values
        if what == REFUSED or math.isnan(value):
            raise InputError("no estimate")
        reached = 1e-6 * self.gain * value * np.array([1.0, -0.5])
        status = Status.UNSETTLED if what == UNSETTLED else Status.OK
        band = np.full(2, 1e-3 if what == WIDE else 1e-7)
        if what == LOST:
            reached = np.array([math.nan, 0.0])
        # The slope has nothing to do with the displacement, but both are often large.
        slope = 1e-6 * self.gain * 600.0 * math.sin(7.0 * value)
        line = np.array([slope, 1e-7, *(1e3 * at for at in STROKE)])
        return np.array([time]), Estimate(time, reached, band, status, line)


def settings_of(
    given: dict[str, Any], two: bool, slope: dict[str, float] | None = None
) -> Settings:
    """Return settings with one axis of the control, or two; the first one may take a slope."""
    axes: dict[str, Any] = {"X": {"follows": "x", "sign": -1}}
    if slope is not None:
        axes["X"]["slope"] = slope
    if two:
        axes["Z"] = {"follows": "y", "sign": 1}
    found = settings_from_data(given | {"axes": axes, "widest_band_um": 10.0}, "offsets.toml")
    return with_slopes(found, {"x": STROKE}, "offsets.toml")


def model_with(
    output: Settings | None, gain: float, handshake: HandshakeSettings | None = None
) -> LoadedModel:
    """Return a model with settings of its output, and of the handshake with its control."""
    found = Gauge(gain)
    controls = () if output is None else output.output.names
    return LoadedModel(
        found,
        f"gauge {gain}",
        "gauge.json",
        of_columns(("T1_K", "T2_K"), 2),
        (),
        None,
        AssemblyRule(INTERVAL, 0.0, 0.0, 2),
        Layout(found.axes, controls, found.details, ("T1_K", "T2_K"), lines_in(output)),
        output,
        handshake,
    )


choices = st.fixed_dictionaries(
    {
        "resolution_um": st.sampled_from([0.1, 1.0, 5.0]),
        "rate_um_s": st.sampled_from([0.05, 1.0, 20.0]),
        "dead_band_um": st.sampled_from([0.0, 2.0]),
        "filter_s": st.sampled_from([0.0, 10.0]),
        "largest_um": st.sampled_from([10.0, 100.0]),
        "oldest_s": st.sampled_from([3.0, 30.0, 200.0]),
        "freeze_s": st.sampled_from([0.0, 10.0]),
        "decay_s": st.sampled_from([5.0, 100.0]),
        "recover_s": st.sampled_from([0.0, 5.0]),
    }
)
slopes = st.fixed_dictionaries(
    {
        "resolution_um_per_m": st.sampled_from([1.0, 5.0]),
        "reference_mm": st.sampled_from([300.0, 300.0, 100.0]),
    }
)
outputs = st.builds(settings_of, choices, st.booleans(), slopes | st.none()) | st.none()
sizes = st.floats(-300.0, 300.0)
kinds = st.sampled_from([SOUND, SOUND, SOUND, REFUSED, UNSETTLED, WIDE, LOST])


class Line(NamedTuple):
    """What a control applies to an axis: offset (m) and slope at a reference position (m)."""

    offset: float = 0.0
    slope: float = 0.0
    reference: float = STROKE.reference

    def at(self, position: float) -> float:
        """Return the correction at a position, m."""
        return self.offset + self.slope * (position - self.reference)


class Allowed(NamedTuple):
    """How fast (m/s) a correction may move, and how far and in which steps its parts."""

    rate: float
    offset: Limits
    slope: Limits

    def and_those_of(self, other: Allowed) -> Allowed:
        """Return what either allows."""
        return Allowed(
            max(self.rate, other.rate),
            *(
                replace(
                    mine,
                    largest=max(mine.largest, its.largest),
                    resolution=max(mine.resolution, its.resolution),
                )
                for mine, its in zip(self[1:], other[1:], strict=True)
            ),
        )

    def at_least(self, line: Line) -> Allowed:
        """Return the same, and no less than a line: a lowered limit may be on its way."""
        offset, slope = (
            replace(limits, largest=max(limits.largest, abs(value)))
            for limits, value in zip(self[1:], line[:2], strict=True)
        )
        return Allowed(self.rate, offset, slope)

    def check(self, name: str, last: Line, line: Line, passed: float, steps: float) -> None:
        """Hold a line against the one before, so many seconds and steps away."""
        for position in np.linspace(STROKE.low, STROKE.high, 6).tolist():
            lever = abs(position - line.reference)
            one_step = self.offset.resolution + lever * self.slope.resolution
            moved = abs(line.at(position) - last.at(position))
            assert moved <= (self.rate * passed + steps * one_step) * (1.0 + 1e-6) + 1e-12, (
                f"{name}: {1e6 * last.at(position):.2f} to {1e6 * line.at(position):.2f} um at "
                f"{1e3 * position:g} mm in {passed:.2f} s"
            )
        # At another reference the same line has another offset.
        first = int(line.reference != last.reference)
        for value, before, limits in list(zip(line[:2], last[:2], self[1:], strict=True))[first:]:
            most = max(limits.largest, abs(before)) + (steps - 1.0) * limits.resolution
            assert abs(value) <= most * (1.0 + 1e-6), f"{name}: {1e6 * value:.2f} um"


class Offsets(RuleBasedStateMachine):
    """A service with one machine, and a control that notes what it receives."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="offsets-"))
        self.true = 0.0  # the time that passes, s
        self.wall = START  # what the computer's clock says beyond it
        self.source = START  # what the source's clock says beyond it
        self.booted = 0.0
        self.model = model_with(None, 1.0)
        self.store: sqlite3.Connection | None = None
        self.fleet: Fleet
        # By axis: what the control received last, and when; how fast, how far and in which steps it
        # may have moved since, by all settings in force; and the axes of which nothing was received
        # since a kill.
        self.control: dict[str, tuple[Line, float]] = {}
        self.allowed: dict[str, Allowed] = {}
        self.unheard: set[str] = set()
        # When the last estimate was made, by both clocks, and by which model; whether an offset may
        # follow it, and how late its sample was, s.
        self.estimated, self.by = (-math.inf, -math.inf), math.nan
        self.sound, self.late = False, 0.0
        # Whether the control is connected and enables offsets; whether it has been away since it
        # took one over; by how much its acknowledgement is wrong, m; its counter, and what the
        # service knows: when it said so last, s, and that it was enabled.
        self.linked, self.enabled, self.away, self.lie = True, True, False, 0.0
        # Whether it has seen since that the service knows: before that it does not enable again.
        self.seen = False
        self.counter, self.told = 0, (-math.inf, False)

    def teardown(self) -> None:
        """Leave nothing."""
        if self.store is not None:
            self.store.close()
        shutil.rmtree(self.folder)

    @property
    def times(self) -> Times:
        """Now, by the clocks of the service."""
        return Times(self.wall + self.true, self.true - self.booted)

    # --- what a service does -----------------------------------------------------------------

    @property
    def service(self) -> Service:
        """The file of the service."""
        model = {"file": "gauge.json", "interval_s": INTERVAL, "offsets": "offsets.toml"}
        machine: dict[str, Any] = {"model": "gauge", "source": "line"}
        if self.model.handshake is not None:
            machine["handshake"] = _SECTION
        content = {
            "folder": str(self.folder),
            "models": {"gauge": model},
            "machines": {MACHINE: machine},
            "sources": {"line": {"kind": "csv", "path": "line.csv"}},
            "ahead_s": 60.0,
            "behind_s": 5.0,
            "mqtt": {},
        }
        return service_from_data(content, "service.toml", self.folder)

    def start(self) -> None:
        """Begin where the store is."""
        self.booted = self.true - 100.0
        self.store = open_store(self.folder / "history.sqlite")
        # Of processes that die, not of computers.
        self.store.execute("PRAGMA synchronous = OFF")
        models = {"gauge": self.model}
        self.fleet, newest = restored_fleet(
            self.service, models, self.store, EventLog(), _METRICS, self.times
        )
        for one in newest:
            self.receive(one)

    def watch(self) -> None:
        """Look at silences, as a service does every second."""
        self.answer()
        changed = processing.check_silence(self.fleet, *self.times)
        self.keep(Batch(received=self.received(changed)))
        for one in changed:
            self.receive(one)

    def absorb(self, readings: Sequence[tuple[float, float, float]], until: str = "") -> None:
        """Take readings (time by the source, value, kind); a kill may come before the end."""
        arrivals = [Arrival(MACHINE, at, told, self.times.now) for at, *told in readings]
        before = self.fleet.machines[MACHINE].state.usable.number
        results = processing.process(self.fleet, arrivals, *self.times)
        if until == "before the commit":
            return
        changed = list(results.publications.values())
        self.keep(Batch(results.samples, (), (), results.gaps, self.received(changed)))
        said = self.fleet.machines[MACHINE].state.usable
        if said.number != before:
            self.estimated = self.times.now, self.true
            self.late = max(0.0, self.times.now - said.time - 5.0 - INTERVAL)
            self.by = self.gain
            self.sound = bool(said.readings[1] == SOUND)
        if until == "before the publication":
            return
        for one in changed:
            self.receive(one)
        self.begin_anew()

    def begin_anew(self) -> None:
        """Take readings of the present again if the clock was set back long ago."""
        assert self.store is not None
        for mill in processing.set_back_machines(self.fleet, self.times):
            self.checkpoint()
            model, now = self.model, self.times.now
            era = new_era(self.store, MACHINE, model.digest, model.layout, now)
            processing.begin_anew(self.fleet, mill, era, now)
            self.keep(Batch(checkpoints=[processing.checkpoint_of(mill)]))

    @property
    def gain(self) -> float:
        """What tells the model from the other one."""
        return self.model.estimator.gain  # type: ignore[attr-defined]

    @property
    def oldest(self) -> float | None:
        """How old an estimate may be."""
        return None if self.model.output is None else self.model.output.trust.oldest

    def received(self, changed: Sequence[Publication]) -> Any:
        """What is kept before it is published."""
        return processing.received_offsets(
            self.fleet, [one.machine for one in changed], self.times.now
        )

    def keep(self, batch: Batch) -> None:
        """Commit."""
        assert self.store is not None
        commit(self.store, batch)

    # --- the control -------------------------------------------------------------------------

    def answer(self) -> None:
        """What the control writes in each of its cycles."""
        if self.model.handshake is None or not self.linked:
            return
        if self.true - self.told[0] > HANDSHAKE.oldest:
            # Who returns says the truth: nobody could tell.
            self.lie = 0.0
        layout, has = self.model.layout, []
        for name in layout.controls:
            line, at = self.control.get(name, (Line(), -math.inf))
            self.control[name] = line, self.true if self.away else at
            has.append(line.offset + self.lie)
        for one in layout.lines:
            has.append(one.lever * self.control[one.axis][0].slope + self.lie)
        self.counter += 1
        self.told = self.true, self.enabled
        processing.receive_answer(
            self.fleet, MACHINE, Answer(self.enabled, self.counter, has), self.times.clock
        )

    def takes(self, said: Publication) -> bool:
        """Whether the control takes over what it is sent; after it was away, with a handshake."""
        if self.model.handshake is None:
            return True
        stands = said.handshake == STANDS
        self.seen = self.seen or (self.linked and not stands)
        self.away = self.away and not (self.linked and stands and self.seen)
        return self.linked and not self.away

    def receive(self, said: Publication) -> None:
        """Hold what is received against what was received last."""
        if self.model.output is None:
            return
        stage = self.model.output.output
        now = {name: Allowed(stage.rate, stage.limits, ZERO) for name in stage.names}
        now |= {own.axis: Allowed(stage.rate, own.offset, own.slope) for own in stage.slopes}
        for name in {*self.control, *now}:
            allowed = now.get(name, Allowed(stage.rate, stage.limits, ZERO))
            self.allowed[name] = allowed.and_those_of(self.allowed.get(name, allowed))
        returned = self.away
        if not self.takes(said):
            return
        lines = zip(said.layout.lines, said.slopes.tolist(), strict=True)
        along = {one.axis: (slope, one.reference) for one, slope in lines}
        for name, offset in zip(said.layout.controls, said.offsets.tolist(), strict=True):
            last, at = self.control.get(name, (Line(), -math.inf))
            # A slope that is no longer sent stays as it was.
            line = Line(offset, *along.get(name, last[1:]))
            # What a kill left in the store may never have been received; what is acknowledged
            # lies between two steps.
            steps = 1.5 if name in self.unheard or returned else 1.0
            self.allowed[name].check(name, last, line, self.true - at, steps)
            self.control[name] = line, self.true
            self.allowed[name] = now[name].at_least(line)
            self.unheard.discard(name)
        if offset_status_of(said) == int(ua.StatusCodes.Good):
            oldest = self.oldest
            assert oldest is not None
            wall, true = self.estimated
            age = max(self.late, min(self.true - true, abs(self.times.now - wall)))
            # A model that took no sample leaves the one before it where that was.
            sound = self.sound and self.by == self.gain
            assert sound, "good, and the last estimate is not usable"
            assert age <= oldest + 1e-6, f"good, and the last estimate is {age:.1f} s old"
            if self.model.handshake is not None:
                at, enabled = self.told
                assert enabled, "good, and the control is disabled"
                assert self.true - at <= HANDSHAKE.oldest, "good, and the control is silent"

    # --- what may happen ---------------------------------------------------------------------

    @initialize(output=outputs, shakes=st.booleans())
    def begin(self, output: Settings | None, shakes: bool) -> None:
        """A new folder."""
        self.model = model_with(output, 1.0, HANDSHAKE if shakes else None)
        self.start()

    @rule(linked=st.booleans(), enabled=st.booleans(), clears=st.booleans())
    def control_leaves(self, linked: bool, enabled: bool, clears: bool) -> None:
        """The control is disabled or disconnected, or comes back; it may clear its offsets."""
        if self.model.handshake is None:
            return
        self.linked, self.enabled, self.lie = linked, enabled, 0.0
        if not (linked and enabled):
            self.away, self.seen = True, False
        if clears and self.away:
            self.control = {
                name: (last._replace(offset=0.0, slope=0.0), self.true)
                for name, (last, _) in self.control.items()
            }

    @rule(
        linked=st.booleans(),
        clears=st.booleans(),
        count=st.sampled_from([3, 8, 25]),
        value=sizes,
    )
    def control_returns(self, linked: bool, clears: bool, count: int, value: float) -> None:
        """The control follows, is away for a time, and comes back."""
        for leaves in (False, True, False):
            self.control_leaves(linked or not leaves, not leaves, leaves and clears)
            self.samples(count, value, 0.0, SOUND)

    @rule(lie=st.sampled_from([0.0, 50e-6, -3e-6]))
    def control_lies(self, lie: float) -> None:
        """The control acknowledges what it has not taken over."""
        self.lie = 0.0 if self.away else lie

    @rule(count=st.integers(1, 30), value=sizes, slope=st.floats(-5.0, 5.0), kind=kinds)
    def samples(self, count: int, value: float, slope: float, kind: int) -> None:
        """Some seconds, each with a sample."""
        for k in range(count):
            self.true += INTERVAL
            self.absorb([(self.source + self.true, value + k * slope, kind)])
            self.watch()

    @rule(seconds=st.sampled_from([1.0, 5.0, 40.0, 600.0, 40_000.0]))
    def silence(self, seconds: float) -> None:
        """Nothing comes; long silences are looked at now and then, as by a busy computer."""
        step = max(1.0, seconds / 40.0)
        for _ in range(int(seconds / step)):
            self.true += step
            self.watch()

    @rule(value=sizes)
    def missing(self, value: float) -> None:
        """A reading is missing."""
        self.true += INTERVAL
        self.absorb([(self.source + self.true, math.nan, SOUND)])

    @rule(count=st.integers(2, 60), behind=st.floats(0.0, 400.0), value=sizes, kind=kinds)
    def backlog(self, count: int, behind: float, value: float, kind: int) -> None:
        """Readings of the past, all at once."""
        self.true += 0.1
        first = self.source + self.true - behind
        self.absorb([(first + k * INTERVAL, value, kind) for k in range(count)])

    @rule(step=st.sampled_from([-4000.0, -50.0, -2.0, 2.0, 50.0, 4000.0]), of=st.integers(0, 2))
    def clock_step(self, step: float, of: int) -> None:
        """Somebody sets the clock of the computer, of the source, or of both."""
        self.wall += step if of != 1 else 0.0
        self.source += step if of != 0 else 0.0

    @rule()
    def clocks_agree(self) -> None:
        """Somebody sets the clock of the source right."""
        self.source = self.wall

    @rule()
    def checkpoint(self) -> None:
        """The state is kept."""
        mill = self.fleet.machines[MACHINE]
        if mill.rows:
            self.keep(Batch(checkpoints=[processing.checkpoint_of(mill)]))

    @rule(
        until=st.sampled_from(["", "before the commit", "before the publication"]),
        value=sizes,
        down=st.sampled_from([0.1, 20.0, 500.0, 40_000.0]),
        output=st.none() | outputs.map(lambda found: (found,)),
        gain=st.none() | st.sampled_from([1.0, -2.0]),
        shakes=st.booleans(),
    )
    def kill(
        self,
        until: str,
        value: float,
        down: float,
        output: tuple[Settings | None] | None,
        gain: float | None,
        shakes: bool,
    ) -> None:
        """A kill at some moment of a sample, and a start with these settings and this model."""
        self.true += INTERVAL
        self.absorb([(self.source + self.true, value, SOUND)], until)
        assert self.store is not None
        self.store.close()
        self.true += down
        before = self.model
        gain = self.gain if gain is None else gain
        # A control that is away would not know that nobody asks for its word any more.
        handshake = HANDSHAKE if shakes or self.away else None
        self.lie, self.told = 0.0, (-math.inf, False)
        self.model = model_with(before.output if output is None else output[0], gain, handshake)
        self.unheard = {"X", "Z"}
        for one in self.model.layout.lines if handshake is not None else ():
            last, at = self.control.get(one.axis, (Line(), -math.inf))
            self.control[one.axis] = last._replace(reference=one.reference), at
            if one.reference != last.reference:
                # Set while its machine stands: it takes no offset until the handshake stands.
                self.away, self.seen = True, False
        self.start()


def violations(sequences: int, steps: int = 30) -> None:
    """Run sequences; raises with the shortest one that violates what must hold.

    `steps`: of each at most.
    """
    run_state_machine_as_test(
        Offsets,
        settings=settings(
            max_examples=sequences,
            stateful_step_count=steps,
            deadline=None,
            derandomize=True,
            database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )


def main() -> None:
    """Run them and print what was run as JSON."""
    parser = options_of(__doc__)
    parser.add_argument("--sequences", type=int, default=10_000)
    given = parser.parse_args()
    begun = time.monotonic()
    violations(given.sequences)
    print(json.dumps({"sequences": given.sequences, "wall_s": round(time.monotonic() - begun, 1)}))


if __name__ == "__main__":
    main()
