"""Handshake with a control: whether it takes over the offsets that it receives.

The control enables the offsets, increments a heartbeat, and acknowledges the offsets that it has
taken over. While the handshake is broken the offsets freeze and decay as without a usable
estimate. A control that was away (disabled, or without a heartbeat) may have held, faded or cleared
its offsets meanwhile; on its return the offsets continue from those that it acknowledges.

Arrays contain the offsets, followed by the slopes, as corrections at the far end of the stroke, m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Reasons why a handshake is broken.
DISABLED, SILENT, DIFFERS = "disabled", "no-heartbeat", "differs"
#: The state of an intact handshake.
STANDS = "stands"


@dataclass(frozen=True)
class HandshakeSettings:
    """Limits of a handshake."""

    #: Longest time without a change of the heartbeat, s.
    oldest: float
    #: Largest difference of an acknowledged offset from those sent last, m; infinite: no
    #: acknowledgement is needed.
    differs: float
    #: Longest time for which an acknowledgement may lag behind, or differ, s.
    differs_time: float


class Answer(NamedTuple):
    """Message of a control, whole or in parts."""

    #: Whether the control takes over offsets; None: not in this message.
    enabled: bool | None = None
    #: Counter; any change shows that the control is alive.
    heartbeat: int | None = None
    #: Offsets that the control has taken over, m, shape (channels,); NaN, or empty: not in this
    #: message.
    acknowledged: Sequence[float] = ()


class Handshake(NamedTuple):
    """State of a handshake."""

    enabled: bool
    #: Last heartbeat; None before the first.
    heartbeat: int | None
    #: Time of its last change, s; -inf for never: the first heartbeat may be years old.
    beaten: float
    #: Shape (channels,): m; NaN for channels not acknowledged since the control was away.
    acknowledged: Array
    #: Times (s) and offsets (m) sent in the last `differs_time`, oldest first.
    sent: tuple[tuple[float, Array], ...]
    #: Shape (channels,): range of the offsets sent since the control last agreed, m.
    low: Array
    high: Array
    #: Time at which the control last agreed, s.
    agreed: float
    #: Whether the control has been away and has not returned.
    away: bool
    #: `STANDS`, or the reason why the handshake is broken.
    state: str


def begun(offsets: Array, clock: float) -> Handshake:
    """Return the handshake with a control that was sent offsets (m) and has not answered yet."""
    return Handshake(
        enabled=False,
        heartbeat=None,
        beaten=-math.inf,
        acknowledged=np.full(offsets.shape, np.nan),
        sent=((clock, offsets),),
        low=offsets,
        high=offsets,
        agreed=-math.inf,
        away=True,
        state=SILENT,
    )


def answered(handshake: Handshake, answer: Answer, clock: float) -> Handshake:
    """Return the handshake after an answer of the control at a time (s)."""
    acknowledged = np.asarray(answer.acknowledged or handshake.acknowledged, dtype=float)
    beats = handshake.heartbeat not in (None, answer.heartbeat) and answer.heartbeat is not None
    return handshake._replace(
        enabled=handshake.enabled if answer.enabled is None else answer.enabled,
        heartbeat=handshake.heartbeat if answer.heartbeat is None else answer.heartbeat,
        beaten=clock if beats else handshake.beaten,
        acknowledged=np.where(np.isfinite(acknowledged), acknowledged, handshake.acknowledged),
    )


def judged(settings: HandshakeSettings, handshake: Handshake, clock: float) -> Handshake:
    """Return the handshake at a time (s) with its updated state.

    When a control returns, `continued_from` gives the offsets to continue from.

    Parameters
    ----------
    settings : HandshakeSettings
    handshake : Handshake
    clock : float
        Time, s; not earlier than in the previous call.
    """
    if clock - handshake.beaten > settings.oldest:
        # Earlier acknowledgements do not count when the control returns.
        unknown = np.full(handshake.low.shape, np.nan)
        return handshake._replace(state=SILENT, away=True, acknowledged=unknown)
    if not handshake.enabled:
        return handshake._replace(state=DISABLED, away=True)
    agrees = _agrees(settings, handshake, clock)
    agreed = clock if agrees else handshake.agreed
    late = clock - agreed > settings.differs_time
    if (handshake.away and not agrees) or late:
        return handshake._replace(state=DIFFERS)
    return handshake._replace(state=STANDS, away=False, agreed=agreed)


def continued_from(
    before: Handshake, after: Handshake, settings: HandshakeSettings
) -> Array | None:
    """Return the offsets (m) in a control that has just returned or agrees again; else None.

    These are the acknowledged offsets, clipped to the range of zero and all offsets sent since the
    control last agreed.

    Parameters
    ----------
    before, after : Handshake
        Before and after `judged`.
    settings : HandshakeSettings
    """
    differed = before.away or before.state == DIFFERS
    if not differed or after.state != STANDS or math.isinf(settings.differs):
        return None
    return np.clip(after.acknowledged, np.minimum(after.low, 0.0), np.maximum(after.high, 0.0))


def sent(
    settings: HandshakeSettings, handshake: Handshake, offsets: Array, clock: float
) -> Handshake:
    """Return the handshake after offsets (m) were sent at a time (s)."""
    recent = (*_recent(settings, handshake, clock), (clock, offsets))
    if handshake.state == STANDS and handshake.agreed == clock:
        # The range includes the offsets in force in the control, however long ago they were sent.
        acts = np.clip(handshake.acknowledged, handshake.low, handshake.high)
        low, high = _range(recent)
        low, high = np.fmin(low, acts), np.fmax(high, acts)
    else:
        low, high = np.minimum(handshake.low, offsets), np.maximum(handshake.high, offsets)
    return handshake._replace(sent=recent, low=low, high=high)


def _recent(
    settings: HandshakeSettings, handshake: Handshake, clock: float
) -> tuple[tuple[float, Array], ...]:
    """Return the offsets in force in the last `differs_time`."""
    first = clock - settings.differs_time
    before = [k for k, (time, _) in enumerate(handshake.sent) if time <= first]
    return handshake.sent[before[-1] if before else 0 :]


def _range(recent: Sequence[tuple[float, Array]]) -> tuple[Array, Array]:
    values = np.array([value for _, value in recent])
    return values.min(axis=0), values.max(axis=0)


def _agrees(settings: HandshakeSettings, handshake: Handshake, clock: float) -> bool:
    """Whether the control has taken over offsets that were sent a short time ago.

    After an absence of the control, any offset counts that was sent since it last agreed, or
    between these and zero. After a difference only the last offset sent counts: offsets that decay
    meanwhile would sooner or later match any wrong acknowledgement.
    """
    if math.isinf(settings.differs):
        return True
    if handshake.away:
        low, high = np.minimum(handshake.low, 0.0), np.maximum(handshake.high, 0.0)
    elif handshake.state == DIFFERS:
        low = high = handshake.sent[-1][1]
    else:
        low, high = _range(_recent(settings, handshake, clock))
    acknowledged = handshake.acknowledged
    return bool(
        ((acknowledged >= low - settings.differs) & (acknowledged <= high + settings.differs)).all()
    )
