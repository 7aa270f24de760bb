"""Names of the pictures that can be drawn, for the command line; without imports for drawing."""

from __future__ import annotations

from enum import StrEnum


class Show(StrEnum):
    """Content of a picture."""

    structure = "structure"
    curves = "curves"
    pressures = "pressures"
    temperature = "temperature"
    deformation = "deformation"
    pressure = "pressure"
    volume = "volume"


class Up(StrEnum):
    """Upward direction of a picture."""

    x = "x"
    y = "y"
    z = "z"
    minus_x = "-x"
    minus_y = "-y"
    minus_z = "-z"

    @property
    def vector(self) -> tuple[float, float, float]:
        """The direction as a unit vector."""
        sign = -1.0 if self.value.startswith("-") else 1.0
        x, y, z = (sign * (self.value[-1] == axis) for axis in "xyz")
        return x, y, z
