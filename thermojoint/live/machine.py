"""One machine: (state, sample) to (state, publication), as a pure function."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimator.quality import Quality, quality_of
from estimator.states import as_bytes, from_bytes
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, ThermojointError
from thermojoint.compensation.offsets.output import (
    OutputState,
    at_zero,
    content_of,
    cycle,
    followed,
    mode_of,
    offsets_of,
)
from thermojoint.compensation.offsets.output import restored as output_restored
from thermojoint.compensation.offsets.usable import usable
from thermojoint.live.publication import Layout, Publication, from_row
from thermojoint.live.samples import Waiting
from thermojoint.live.served import Served
from thermojoint.live.store import Kept
from thermojoint.live.watchdog import REFUSED, quality_at, silenced


@dataclass(frozen=True, eq=False, slots=True)
class Machine:
    """State of a machine.

    Attributes
    ----------
    name : str
    state : ndarray
        Of its estimator.
    cold : float
        Temperature at which it was cold, in the unit of its readings; NaN if not known yet.
    output : OutputState or None
        Of its compensation output.
    waiting : Waiting
        What arrived and is in no sample yet.
    said : Publication
        The newest.
    usable : Publication
        The newest with an estimate.
    """

    name: str
    state: Array
    cold: float
    output: OutputState | None
    waiting: Waiting
    said: Publication
    usable: Publication


def at_rest(name: str, served: Served, now: float) -> Machine:
    """Return a machine of which nothing has been read, at a time (s since 1970)."""
    layout = served.layout
    unknown = [
        np.full(len(names), np.nan)
        for names in (layout.axes, layout.axes, layout.details, layout.readings)
    ]
    nothing = Publication(
        machine=name,
        number=0,
        time=math.nan,
        published=now,
        quality=Quality.BAD,
        layout=layout,
        displacement=unknown[0],
        band=unknown[1],
        offsets=np.zeros(len(layout.controls)),
        details=unknown[2],
        readings=unknown[3],
        status="no-sample",
    )
    output = at_zero(served.output.output) if served.output else None
    start = served.estimator.initial_state()
    return Machine(name, start, math.nan, output, Waiting(), nothing, nothing)


def taken(
    served: Served, machine: Machine, instant: float, readings: tuple[float, ...], now: float
) -> tuple[Machine, str]:
    """Return a machine after one sample, and why the estimator refused it (empty if it did not).

    Parameters
    ----------
    served : Served
        Its model.
    machine : Machine
        Before; `waiting` stays as it is.
    instant : float
        Of the sample, s since 1970.
    readings : tuple of float
        As `served.intake.names`, NaN for what is missing.
    now : float
        When it is published, s since 1970.
    """
    given = served.intake.usable(readings)
    values, cold = served.intake.convert(given, machine.cold)
    number = machine.said.number + 1
    told = np.array(given)
    try:
        state, estimate = served.estimator.sample(machine.state, instant, values)
    except ThermojointError as error:
        # The sample is kept, so that nobody takes it again; the estimate stays what it was.
        output = _cycled(served, machine.output, instant, None)
        nothing = Publication(
            machine=machine.name,
            number=number,
            time=instant,
            published=now,
            quality=Quality.UNCERTAIN,
            layout=served.layout,
            displacement=np.full(len(served.layout.axes), np.nan),
            band=np.full(len(served.layout.axes), np.nan),
            offsets=_offsets(served, output),
            details=np.full(len(served.layout.details), np.nan),
            readings=told,
            status=REFUSED,
            offset_mode=_mode(served, output),
        )
        return replace(machine, cold=cold, output=output, said=nothing), str(error)
    words, reached = estimate.words, estimate.displacement
    sound = bool(np.isfinite(reached).all())
    trust = served.output.trust if served.output else None
    used = sound and trust is not None and usable(trust, 0.0, estimate.band, words)
    target = None
    if used and served.output is not None:
        target = followed(served.output.output, served.layout.axes, reached)
    output = _cycled(served, machine.output, instant, target)
    said = Publication(
        machine.name,
        number,
        instant,
        now,
        quality_of(words, reached),
        served.layout,
        reached,
        estimate.band,
        _offsets(served, output),
        estimate.details,
        told,
        words,
        _mode(served, output),
    )
    return Machine(machine.name, state, cold, output, machine.waiting, said, said), ""


def with_waiting(machine: Machine, waiting: Waiting) -> Machine:
    """Return a machine with other readings that wait; far quicker than `dataclasses.replace`."""
    return Machine(
        machine.name,
        machine.state,
        machine.cold,
        machine.output,
        waiting,
        machine.said,
        machine.usable,
    )


def shown(machine: Machine) -> Publication:
    """Return what is said of a machine now: after a refused sample, the last estimate."""
    said, last = machine.said, machine.usable
    if said.number == last.number or last.number == 0:
        return said
    return replace(
        said, displacement=last.displacement, band=last.band, details=last.details, time=last.time
    )


def silent(
    served: Served, machine: Machine, age: float, now: float, uncertain: float, bad: float
) -> tuple[Machine, Publication]:
    """Return a machine, and what is said of it, some time (s) after its last usable sample.

    The offsets freeze and decay as their settings say; an estimate that is too old moves none.
    """
    output = machine.output
    told = machine.said.number > 0
    if (
        served.output is not None
        and output is not None
        and told
        and age > served.output.trust.oldest
    ):
        # The age is that of the last estimate: refused samples since then have times of their own.
        output = _cycled(served, output, machine.usable.time + age, None)
    before = shown(machine)
    quality = quality_at(age, uncertain, bad) if before.number else Quality.BAD
    said = replace(
        before,
        published=now,
        quality=max(before.quality, quality),
        offsets=_offsets(served, output),
        offset_mode=_mode(served, output),
        status=silenced(before.status, quality) if before.number else before.status,
    )
    return replace(machine, output=output), said


def _cycled(
    served: Served, output: OutputState | None, time: float, target: Array | None
) -> OutputState | None:
    """The compensation output after a sample; a silence may have brought its clock further."""
    if served.output is None or output is None:
        return None
    later = time if math.isnan(output.time) else max(time, output.time)
    return cycle(served.output.output, output, later, target)


def _offsets(served: Served, output: OutputState | None) -> Array:
    if served.output is None or output is None:
        return np.empty(0)
    return offsets_of(served.output.output, output)


def _mode(served: Served, output: OutputState | None) -> str:
    if served.output is None or output is None:
        return ""
    return mode_of(served.output.output, output).value


def state_bytes(served: Served, machine: Machine) -> bytes:
    """Return what the estimator needs, as the store keeps it."""
    return as_bytes(served.digest, np.concatenate(([machine.cold], machine.state)))


def rest_of(served: Served, machine: Machine, position: Any) -> str:  # noqa: ANN401
    """Return what else the next sample depends on, as the store keeps it: JSON.

    Parameters
    ----------
    served : Served
        Its model.
    machine : Machine
    position : JSON value
        How far its source was read.
    """
    output = machine.output
    content: dict[str, Any] = {"at": position, "waiting": machine.waiting}
    if served.output is not None and output is not None:
        content["output"] = content_of(served.output.output, output)
    return json.dumps(content)


def restored(
    name: str, served: Served, kept: Kept, last: Publication | None, now: float
) -> tuple[Machine, Any]:
    """Return a machine as it was when its last sample was kept, and where its source stood.

    Samples since the last checkpoint run through the estimator again. The offsets go on from what
    the control received last, whatever the settings were then; for as long as nothing came they
    have frozen and decayed, as they would have in a service that ran.

    Parameters
    ----------
    name : str
    served : Served
    kept : Kept
        What the store has of it; the axes of the control may have been others.
    last : Publication or None
        The sample of the checkpoint.
    now : float
        s since 1970.

    Raises
    ------
    InputError
        The samples do not lead to what was said of them: another model, or a damaged store.
    """
    machine = at_rest(name, served, now)
    if kept.state is not None and last is not None:
        found = from_bytes(kept.state, served.digest, name)
        if found.size != machine.state.size + 1:
            raise InputError(f"{name}: the state that is kept is damaged; give another folder")
        machine = replace(
            machine,
            cold=float(found[0]),
            state=found[1:],
            said=_laid_out(last, served.layout),
            usable=_laid_out(last, served.layout),
            output=_output(served, json.loads(kept.rest).get("output")),
        )
    for one in kept.later:
        row = from_row(name, one.number, kept.layout, np.frombuffer(one.row), one.status)
        readings = tuple(row.readings.tolist())
        machine, _ = taken(served, machine, row.time, readings, row.published)
    rest = json.loads(kept.later[-1].rest if kept.later else kept.rest)
    # Not what the samples would lead to under settings that have changed since.
    output = _output(served, rest.get("output"))
    if served.output is not None and output is not None and machine.said.number:
        settings, oldest = served.output.output, served.output.trust.oldest
        # By the clock of the service: the source's own may stand elsewhere.
        silence = now - machine.usable.published
        for age in (oldest, silence) if silence > oldest else ():
            time = max(machine.usable.time + age, output.time)
            output = cycle(replace(settings, longest_cycle=math.inf), output, time, None)
    said = replace(
        machine.said, offsets=_offsets(served, output), offset_mode=_mode(served, output)
    )
    waiting = _waiting(rest.get("waiting"))
    return replace(machine, output=output, waiting=waiting, said=said), rest.get("at")


def _laid_out(last: Publication, layout: Layout) -> Publication:
    """Return a publication for axes of the control that are others since; they have no offset."""
    if last.layout == layout:
        return last
    return replace(last, layout=layout, offsets=np.zeros(len(layout.controls)))


def _waiting(content: list[Any] | None) -> Waiting:
    if content is None:
        return Waiting()
    before, newest, cells, held, phase, probed = content
    return Waiting(
        before,
        newest,
        tuple((instant, tuple(values)) for instant, values in cells),
        tuple((since, value) for since, value in held),
        phase,
        probed,
    )


def _output(served: Served, content: dict[str, Any] | None) -> OutputState | None:
    """Return the compensation output that goes on from what the control received last."""
    if served.output is None:
        return None
    settings = served.output.output
    return at_zero(settings) if content is None else output_restored(settings, content)
