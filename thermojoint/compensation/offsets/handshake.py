"""Handshake with a control: whether it takes over the offsets that it receives.

The control enables the offsets, counts a heartbeat on, and acknowledges the offsets that it has
taken over. While the handshake is broken the offsets freeze and decay as without a usable
estimate. A control that was away (disabled, or without a heartbeat) may have held, faded or cleared
its offsets meanwhile; it continues from those that it acknowledges when it returns.

For an axis with a slope the slope stands behind the offsets, by the correction that it makes at the
far end of the stroke, m.
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

    #: A heartbeat that has not changed for longer breaks it, s.
    oldest: float
    #: An acknowledged offset may be this far from those sent last, m; infinite: none is needed.
    differs: float
    #: An acknowledgement may lag behind by this time, and differ for so long, s.
    differs_time: float


class Answer(NamedTuple):
    """Message of a control, whole or in parts."""

    #: Whether it takes over offsets; None: not said now.
    enabled: bool | None = None
    #: A counter; any change is a sign of life.
    heartbeat: int | None = None
    #: The offsets that it has taken over, m, shape (channels,); NaN, or empty: not said now.
    acknowledged: Sequence[float] = ()


class Handshake(NamedTuple):
    """State of a handshake."""

    enabled: bool
    #: The last one; None before the first.
    heartbeat: int | None
    #: When it changed last, s; -inf for never. A first one may be years old.
    beaten: float
    #: Shape (channels,): m; NaN where the control has not acknowledged since it was away.
    acknowledged: Array
    #: Time (s) and offsets (m) of what was sent in the last `differs_time`, oldest first.
    sent: tuple[tuple[float, Array], ...]
    #: Shape (channels,): range of what was sent since the control last agreed, m.
    low: Array
    high: Array
    #: When it did, s.
    agreed: float
    #: It has been away, and has not returned.
    away: bool
    #: `STANDS`, or why it is broken.
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
    """Return the handshake at a time (s), with whether it stands.

    Where a control returns, `continued_from` says from which offsets.

    Parameters
    ----------
    settings : HandshakeSettings
    handshake : Handshake
    clock : float
        s; not earlier than before.
    """
    if clock - handshake.beaten > settings.oldest:
        # What it acknowledged before does not count when it returns.
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
    """Return the offsets (m) of a control that has just returned, or agrees again; None: neither.

    They are those that it acknowledges, within what it was sent since it last agreed, and zero.

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
        # What acts in the control stays among it, however long ago it was sent.
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
    """Whether the control has taken over something that it was sent a short time ago.

    After it was away: anything that it was sent since it agreed last, or on the way to zero. After
    it differed: what was sent last. What decays meanwhile would meet any wrong acknowledgement.
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
