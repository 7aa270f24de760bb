"""Names of the tests, without imports of their implementation."""

from __future__ import annotations

from enum import StrEnum


class Protocol(StrEnum):
    """The tests that are evaluated."""

    ETVE = "etve"
    SPINDLE = "spindle"
    LINEAR_AXIS = "linear-axis"
    ROTARY_AXIS = "rotary-axis"

    @property
    def heading(self) -> str:
        """Name of the test."""
        return _TITLES[self]


_TITLES = {
    Protocol.ETVE: "Environmental temperature variation error (ETVE)",
    Protocol.SPINDLE: "Thermal distortion caused by a rotating spindle",
    Protocol.LINEAR_AXIS: "Thermal distortion caused by a moving linear axis",
    Protocol.ROTARY_AXIS: "Thermal distortion caused by rotary motion",
}
