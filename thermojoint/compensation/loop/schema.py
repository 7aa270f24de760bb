"""Schema of the file of a closed loop: plant, estimator, actuators, requirements."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from fesim.case.thermal_sections import HeatInput
from thermojoint.artefacts.settings.read import read_settings
from thermojoint.artefacts.settings.section import (
    File,
    Finite,
    Fraction,
    NotNegative,
    Positive,
    Section,
)
from thermojoint.compensation.offsets.settings import MOST_STEPS


class PlantSection(Section):
    """``[plant]``: the machine, and the heat input of its sources except the heater."""

    case: File
    heat_input: HeatInput
    duration_min: Positive
    judged_from_min: NotNegative = 0.0

    @model_validator(mode="after")
    def _judged_within(self) -> PlantSection:
        if self.judged_from_min >= self.duration_min:
            raise ValueError("judged_from_min is not before the end at duration_min")
        return self


class EstimatorSection(Section):
    """``[estimator]``: a joint-aware model, sensor noise and delay."""

    model: File
    noise_pp_K: NotNegative = 0.12
    seed: Annotated[int, Field(ge=0)] = 0
    delay_s: NotNegative = 0.0


class HeaterSection(Section):
    """``[heater]``: the controlled source, the controlled axis, the source for feed-forward."""

    source: str
    axis: str
    against: str
    largest_W: Positive
    resolution_W: NotNegative = 0.0
    setpoint_um: Finite = 0.0

    @model_validator(mode="after")
    def _countable(self) -> HeaterSection:
        steps = self.largest_W / self.resolution_W if self.resolution_W else 1.0
        if not 1.0 <= steps <= MOST_STEPS:
            raise ValueError(
                f"resolution_W must be 0, or largest_W in 1 to {MOST_STEPS:.0e} steps of it"
            )
        return self


class TuningSection(Section):
    """``[tuning]``: requirements for the tuned loop."""

    gain_margin_dB: Annotated[float, Field(gt=0.0, le=100.0)] = 6.0
    phase_margin_deg: Annotated[float, Field(gt=0.0, lt=180.0)] = 45.0
    gain_error: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.3
    delay_error_s: Annotated[float, Field(ge=0.0, le=86400.0)] = 2.0
    heat_noise: Fraction = 0.02


class Loop(Section):
    """A closed loop as defined in its file."""

    title: str
    plant: PlantSection
    estimator: EstimatorSection
    heater: HeaterSection | None = None
    tuning: TuningSection = TuningSection()
    offsets: File | None = None
    tried_delays_s: list[NotNegative] = []

    @model_validator(mode="after")
    def _something_acts(self) -> Loop:
        if self.heater is None and self.offsets is None:
            raise ValueError("nothing acts on the machine: add [heater] or offsets")
        return self


def read_loop(path: Path | str) -> Loop:
    """Read the file of a closed loop; file names in it are relative to its folder.

    Parameters
    ----------
    path : Path or str
        TOML.

    Raises
    ------
    InputError
        The file is missing or not TOML, a key is unknown or missing, or a value is out of range.
    """
    return read_settings(Loop, Path(path), "loop")
