"""What a picture can show: names only, so that the command line can list them without drawing."""

from __future__ import annotations

from enum import StrEnum


class Show(StrEnum):
    """What a picture shows."""

    structure = "structure"
    curves = "curves"
    pressures = "pressures"
    temperature = "temperature"
    deformation = "deformation"
    pressure = "pressure"


class Up(StrEnum):
    """What points upwards in a picture."""

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
