"""One machine: (state, sample) to (state, publication), as a pure function."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from pydantic import TypeAdapter

from estimator.interface import Estimate, Status
from estimator.lines import Lines, lines_of
from estimator.quality import Quality, quality_of
from estimator.states import as_bytes, completed, from_bytes
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, ThermojointError
from thermojoint.compensation.offsets.handshake import (
    STANDS,
    Handshake,
    begun,
    continued_from,
    judged,
    sent,
)
from thermojoint.compensation.offsets.output import (
    OutputState,
    at_zero,
    band_along,
    content_of,
    corrections_of,
    cycle,
    followed,
    mode_of,
    moved_to,
    offsets_of,
    slopes_of,
)
from thermojoint.compensation.offsets.output import restored as restore_output
from thermojoint.compensation.offsets.usable import usable
from thermojoint.live.loaded_models import LoadedModel
from thermojoint.live.next_reading import ReadingRequest, after_sample, ended
from thermojoint.live.publication import NO_REQUEST, Layout, Publication, from_row
from thermojoint.live.quality import REFUSED, quality_at, silent_status
from thermojoint.live.samples import AssemblyState
from thermojoint.live.settings import WatchdogSection
from thermojoint.live.store import ReceivedOffsets, StoredEra


class Times(NamedTuple):
    """The same moment on two clocks."""

    #: s since 1970, by the system clock, which may be set.
    now: float
    #: The service's own monotonic clock, s. Offsets move by this clock, independently of the times
    #: of the readings: their rate is limited in the time in which the control receives them.
    clock: float


#: From the JSON of `rest_of`.
ASSEMBLY = TypeAdapter(AssemblyState)


class MachineState(NamedTuple):
    """State of a machine."""

    name: str
    estimator_state: Array
    #: Temperature of the cold machine, in the unit of its readings; NaN if not known yet.
    cold: float
    output: OutputState | None
    #: Handshake with its control; without effect if the settings have none.
    handshake: Handshake
    #: Readings not assigned to a sample yet.
    assembly: AssemblyState
    #: The newest publication.
    latest: Publication
    #: The newest publication with an estimate.
    usable: Publication
    request: ReadingRequest = NO_REQUEST


def initial_state(name: str, model: LoadedModel, now: float) -> MachineState:
    """Return a machine without any reading yet, at a time (s since 1970)."""
    nothing = _empty_publication(name, model.layout, now)
    output = at_zero(model.output.output) if model.output else None
    start = model.estimator.initial_state()
    handshake = begun(_corrections(model, output), -math.inf)
    return MachineState(name, start, math.nan, output, handshake, AssemblyState(), nothing, nothing)


def begun_anew(model: LoadedModel, state: MachineState) -> MachineState:
    """Return a machine whose next sample may be earlier than its last; its offsets continue."""
    return state._replace(
        estimator_state=model.estimator.initial_state(),
        assembly=AssemblyState(),
        request=state.request._replace(not_before=-math.inf),
    )


def _empty_publication(name: str, layout: Layout, now: float) -> Publication:
    """Return the publication of a machine without any data, at a time (s since 1970)."""
    unknown = np.full(len(layout.axes), np.nan)
    return Publication(
        machine=name,
        number=0,
        time=math.nan,
        published=now,
        quality=Quality.BAD,
        layout=layout,
        displacement=unknown,
        band=unknown,
        offsets=np.zeros(len(layout.controls)),
        details=np.full(len(layout.details), np.nan),
        readings=np.full(len(layout.readings), np.nan),
        status="no-sample",
        slopes=np.zeros(len(layout.lines)),
    )


def process_sample(
    model: LoadedModel,
    state: MachineState,
    sample: tuple[float, tuple[float, ...]],
    times: Times,
    age: float,
    silence: float,
) -> tuple[MachineState, str]:
    """Return a machine after one sample, and why the estimator refused the sample, or "".

    A sample that is refused is a pause: the offsets follow the last estimate until it is too old.

    The sample is its instant, s since 1970, and its readings in the order of `model.intake.names`;
    NaN for missing ones. It is published at `times`; then it and the last estimate before it have
    the ages `age` and `silence`, s.
    """
    (instant, readings), now = sample, times.now
    state = update_handshake(model, state, times.clock)
    given = model.intake.usable(readings)
    values, cold = model.intake.convert(given, state.cold)
    number = state.latest.number + 1
    usable_readings = np.array(given)
    try:
        estimator_state, estimate = model.estimator.sample(state.estimator_state, instant, values)
    except ThermojointError as error:
        # The sample is stored, so that it is not read again; the estimate does not change.
        # Before the first one, too, it is a pause: there is nothing yet that it could freeze.
        if state.output is not None and not math.isnan(state.output.time):
            state = _cycle_output(model, state, times.clock, _targets(model, silence, state.usable))
        nothing = replace(
            _empty_publication(state.name, model.layout, now),
            number=number,
            time=instant,
            quality=Quality.UNCERTAIN,
            readings=usable_readings,
            status=REFUSED,
            request=state.request,
            **_control_values(model, state),
        )
        return state._replace(cold=cold, latest=nothing), str(error)
    words, reached = estimate.words, estimate.displacement
    state = _cycle_output(model, state, times.clock, _targets(model, age, estimate))
    request = state.request
    if model.request_limits is not None:
        # A refused reading needs confirmation: the request remains.
        refused = Status.READING_REFUSED in estimate.status
        read = [] if refused else _read_axes(model, given)
        request = after_sample(
            model.request_limits, request, instant, read, estimate.band, estimator_state
        )
    latest = Publication(
        state.name,
        number,
        instant,
        now,
        quality_of(words, reached),
        model.layout,
        reached,
        estimate.band,
        details=estimate.details,
        readings=usable_readings,
        status=words,
        request=request,
        **_control_values(model, state),
    )
    state = state._replace(
        estimator_state=estimator_state, cold=cold, latest=latest, usable=latest, request=request
    )
    return state, ""


def _read_axes(model: LoadedModel, given: Sequence[float]) -> list[str]:
    """Return the axes whose displacement is among the readings of a sample."""
    wanted = model.intake.wanted
    names = model.layout.readings[wanted:]
    last_occasional = zip(names, given[wanted:], strict=True)
    return [name.removesuffix("_um") for name, value in last_occasional if math.isfinite(value)]


def postpone_reading(model: LoadedModel, state: MachineState) -> MachineState:
    """Return a machine with its request for a reading postponed; it is repeated later."""
    if model.request_limits is None or not state.request.axis:
        return state
    request = ended(model.request_limits, state.request, state.latest.time, "postponed")
    latest = replace(state.latest, request=request)
    return state._replace(request=request, latest=latest)


def publication_of(state: MachineState) -> Publication:
    """Return the present publication of a machine: after a refused sample, the last estimate."""
    latest, last = state.latest, state.usable
    if latest.number == last.number or last.number == 0:
        return latest
    return replace(
        latest, displacement=last.displacement, band=last.band, details=last.details, time=last.time
    )


def after_silence(
    model: LoadedModel, state: MachineState, age: float, times: Times, limits: WatchdogSection
) -> tuple[MachineState, Publication]:
    """Return a machine and its publication some time (s) after its last usable sample.

    The offsets freeze and decay according to their settings: neither an estimate that is too old
    nor one without the control's handshake moves them.
    """
    state = update_handshake(model, state, times.clock)
    if (
        model.output is not None
        and state.output is not None
        and state.output.used
        and (age > model.output.trust.oldest or _handshake_state(model, state) not in ("", STANDS))
    ):
        state = _cycle_output(model, state, times.clock, None)
    before = publication_of(state)
    quality = quality_at(age, limits.uncertain_s, limits.bad_s) if before.number else Quality.BAD
    latest = replace(
        before,
        published=times.now,
        quality=max(before.quality, quality),
        status=silent_status(before.status, quality) if before.number else before.status,
        **_control_values(model, state),
    )
    return state, latest


def update_handshake(model: LoadedModel, state: MachineState, clock: float) -> MachineState:
    """Return a machine with its handshake updated to a time of the service's own clock (s).

    For a control that returns, the offsets continue from the ones in it.
    """
    if model.handshake is None or model.output is None or state.output is None:
        return state
    handshake, output = judged(model.handshake, state.handshake, clock), state.output
    acts = continued_from(state.handshake, handshake, model.handshake)
    if acts is not None:
        output = moved_to(model.output.output, output, acts, clock)
        handshake = sent(model.handshake, handshake, _corrections(model, output), clock)
    return state._replace(output=output, handshake=handshake)


def with_held_offsets(latest: Publication) -> Publication:
    """Return a publication for times when nothing can be stored: the offsets are held."""
    mode = "freeze" if latest.offset_mode == "follow" else latest.offset_mode
    return replace(latest, quality=max(latest.quality, Quality.UNCERTAIN), offset_mode=mode)


def _cycle_output(
    model: LoadedModel, state: MachineState, clock: float, target: Array | None
) -> MachineState:
    """Return a machine after one cycle of its output, without a target if the handshake broke."""
    if model.output is None or state.output is None:
        return state
    settings, handshake = model.output.output, state.handshake
    if _handshake_state(model, state) not in ("", STANDS):
        target = None
    output = cycle(settings, state.output, clock, target)
    if model.handshake is not None:
        handshake = sent(model.handshake, handshake, _corrections(model, output), clock)
    return state._replace(output=output, handshake=handshake)


def _handshake_state(model: LoadedModel, state: MachineState) -> str:
    """Return the state of the handshake; empty if there is none."""
    return "" if model.handshake is None or model.output is None else state.handshake.state


def _control_values(model: LoadedModel, state: MachineState) -> dict[str, Any]:
    """Return the control's part of a publication: offsets, slopes, their mode, the handshake."""
    handshake = _handshake_state(model, state)
    if model.output is None or state.output is None:
        empty = np.empty(0)
        return {"offsets": empty, "slopes": empty, "offset_mode": "", "handshake": handshake}
    settings, output = model.output.output, state.output
    return {
        "offsets": offsets_of(settings, output),
        "slopes": slopes_of(settings, output),
        "offset_mode": mode_of(settings, output).value,
        "handshake": handshake,
    }


def _corrections(model: LoadedModel, output: OutputState | None) -> Array:
    """Return the values of a handshake: offsets, and corrections by slopes at the far end, m."""
    if model.output is None or output is None:
        return np.empty(0)
    return corrections_of(model.output.output, output)


def _is_usable(model: LoadedModel, age: float, last: Estimate | Publication) -> bool:
    """Whether an estimate of an age (s) may move an axis."""
    if model.output is None or not np.isfinite(last.displacement).all():
        return False
    band = band_along(model.output.output, model.layout.axes, last.band, _lines(model, last))
    words = last.status if isinstance(last, Publication) else last.words
    return usable(model.output.trust, age, band, words)


def _targets(model: LoadedModel, age: float, last: Estimate | Publication) -> Array | None:
    """Return the targets of the offsets and slopes by an estimate of an age (s) that is usable."""
    if model.output is None or not _is_usable(model, age, last):
        return None
    places = {name: float(last.details[k]) for name, k in model.places.items()}
    seen = last.displacement, _lines(model, last), places
    return followed(model.output.output, model.layout.axes, *seen)


def _lines(model: LoadedModel, last: Estimate | Publication) -> Lines | None:
    """Return the lines of an estimate, if the control receives any."""
    if not model.layout.lines:
        return None
    return lines_of(model.layout.axes, model.layout.details, last.details)


def state_bytes(model: LoadedModel, state: MachineState) -> bytes:
    """Return the estimator's state in its stored form."""
    return as_bytes(model.digest, np.concatenate(([state.cold], state.estimator_state)))


def rest_of(state: MachineState, position: Any) -> str:  # noqa: ANN401
    """Return everything else that the next sample depends on, in its stored form: JSON."""
    return json.dumps({"at": position, "waiting": state.assembly, "asked": state.request})


def received_record(model: LoadedModel, state: MachineState, now: float) -> ReceivedOffsets | None:
    """Return the offsets that the control receives, in stored form; None without offsets."""
    if model.output is None or state.output is None:
        return None
    content = content_of(model.output.output, state.output)
    if model.handshake is not None:
        levers = model.output.output.channels.levers
        low, high = state.handshake.low / levers, state.handshake.high / levers
        axes = content["axes"]
        slopes = [axes[one.axis]["slope"] for one in model.output.output.slopes]
        for k, value in enumerate([*axes.values(), *slopes]):
            value["sent"] = [float(low[k]), float(high[k])]
    return ReceivedOffsets(state.name, now, json.dumps(content))


def restore_state(
    name: str,
    model: LoadedModel,
    stored: StoredEra,
    last: Publication | None,
    received: ReceivedOffsets | None,
    times: Times,
) -> tuple[MachineState, Any]:
    """Return a machine restored to its last stored sample, and the read position of its source.

    Samples since the last checkpoint run through the estimator again. The offsets continue from the
    values received last by the control, even under another model or other settings. `stored` may
    have other axes of the control; `last` is the sample of the checkpoint.

    Raises
    ------
    InputError
        The stored state does not fit the model: another model, or a damaged store.
    """
    state = initial_state(name, model, times.now)._replace(output=None)
    if stored.state is not None and last is not None:
        numbers = from_bytes(stored.state, model.digest, name)
        estimator_state = completed(numbers[1:], state.estimator_state)
        if estimator_state.size != state.estimator_state.size:
            raise InputError(f"{name}: the state that is kept is damaged; give another folder")
        state = state._replace(
            cold=float(numbers[0]),
            estimator_state=estimator_state,
            latest=_with_layout(last, model.layout),
            usable=_with_layout(last, model.layout),
        )
    for later in stored.later:
        row = from_row(name, later.number, stored.layout, np.frombuffer(later.row), later.status)
        sample = row.time, tuple(row.readings.tolist())
        state, _ = process_sample(model, state, sample, Times(row.published, math.nan), 0.0, 0.0)
    rest = json.loads(stored.newest)
    output = _restore_output(model, state, received, times)
    handshake = _restore_handshake(model, output, received, times.clock)
    state = state._replace(
        output=output,
        handshake=handshake,
        assembly=ASSEMBLY.validate_python(rest.get("waiting", ())),
        request=ReadingRequest(*rest.get("asked", ())) if model.request_limits else NO_REQUEST,
    )
    latest = replace(state.latest, request=state.request, **_control_values(model, state))
    return state._replace(latest=latest), rest.get("at")


def _restore_handshake(
    model: LoadedModel, output: OutputState | None, received: ReceivedOffsets | None, clock: float
) -> Handshake:
    """Return the handshake of a restored machine, at a time (s).

    The control may still have values that it was sent before it last agreed.
    """
    handshake = begun(_corrections(model, output), clock)
    if model.output is None or received is None:
        return handshake
    axes = json.loads(received.content)["axes"]
    settings = model.output.output
    stored = [axes.get(name, {}) for name in settings.names]
    stored += [axes.get(one.axis, {}).get("slope", {}) for one in settings.slopes]
    # Axes without stored values have no range.
    ranges = np.array([one.get("sent", [np.nan, np.nan]) for one in stored])
    ranges *= settings.channels.levers[:, None]
    low, high = np.fmin(handshake.low, ranges[:, 0]), np.fmax(handshake.high, ranges[:, 1])
    return handshake._replace(low=low, high=high)


def _with_layout(last: Publication, layout: Layout) -> Publication:
    """Return a publication for changed axes of the control, which have no offset."""
    if last.layout == layout:
        return last
    offsets, slopes = np.zeros(len(layout.controls)), np.zeros(len(layout.lines))
    return replace(last, layout=layout, offsets=offsets, slopes=slopes)


def _restore_output(
    model: LoadedModel, state: MachineState, received: ReceivedOffsets | None, times: Times
) -> OutputState | None:
    """Return the compensation output that continues from the values received last by the control.

    It follows only if the machine's last estimate is usable under the present settings; else it
    freezes and decays as if the estimate had become too old while the service ran.
    """
    if model.output is None:
        return None
    settings, trust, last = model.output.output, model.output.trust, state.usable
    if received is None:
        return at_zero(settings)
    silence = max(0.0, times.now - received.at)
    output = restore_output(settings, json.loads(received.content), times.clock, silence)
    if not output.used or not math.isnan(output.unusable_since):
        return output
    age = times.now - last.published
    # An estimate from the future was made before the clock was set back, at an unknown time.
    if age >= 0.0 and _is_usable(model, age, last):
        return output
    frozen = cycle(settings, output, times.clock, None)
    return frozen._replace(unusable_since=times.clock - max(0.0, silence - trust.oldest))
