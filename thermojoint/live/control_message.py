"""Message of a control, by MQTT or HTTP: enable, heartbeat, acknowledged offsets (the handshake).

``{"enable": true, "heartbeat": 17, "offsets_um": {"X": -12.3}}``
"""

from __future__ import annotations

import math

from pydantic import BaseModel

from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.handshake import Answer


class ControlMessage(BaseModel):
    """Message of a control; further keys are its own."""

    enable: bool
    heartbeat: int
    offsets_um: dict[str, float | None] = {}


def answer_of(payload: bytes, axes: tuple[str, ...]) -> Answer:
    """Return what a control says.

    Raises
    ------
    ValidationError
        It is no answer.
    """
    message = ControlMessage.model_validate_json(payload, strict=True)
    offsets = (message.offsets_um.get(axis) for axis in axes)
    metres = tuple(math.nan if one is None else MICRO * one for one in offsets)
    return Answer(message.enable, message.heartbeat, metres)
