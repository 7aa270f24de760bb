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
