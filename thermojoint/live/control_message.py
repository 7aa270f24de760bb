"""Message of a control, by MQTT or HTTP: enable, heartbeat, acknowledged offsets (the handshake).

``{"enable": true, "heartbeat": 17, "offsets_um": {"X": -12.3}}``, and for axes with a slope
``"slopes_um_per_m": {"X": 40.0}``.
"""

from __future__ import annotations

import math

from pydantic import BaseModel

from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.handshake import Answer
from thermojoint.live.publication import Layout


class ControlMessage(BaseModel):
    """Message of a control; further keys are ignored."""

    enable: bool
    heartbeat: int
    offsets_um: dict[str, float | None] = {}
    slopes_um_per_m: dict[str, float | None] = {}


def answer_of(payload: bytes, layout: Layout) -> Answer:
    """Parse the message of a control.

    Raises
    ------
    ValidationError
        The message is not an answer.
    """
    message = ControlMessage.model_validate_json(payload, strict=True)
    acknowledged = [message.offsets_um.get(axis) for axis in layout.controls]
    acknowledged += [message.slopes_um_per_m.get(line.axis) for line in layout.lines]
    metres = tuple(
        math.nan if one is None else MICRO * lever * one
        for one, lever in zip(acknowledged, layout.levers.tolist(), strict=True)
    )
    return Answer(message.enable, message.heartbeat, metres)
